"""Base of the models of tables in files; :func:`validated` checks a table against one."""

from pydantic import BaseModel, ConfigDict


class Parameters(BaseModel):
    """Base of the models of tables: unknown keys are errors, values do not change.

    Strict: a number written as text, or true for 1, is a slip and refused.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)
