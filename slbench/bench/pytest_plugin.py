"""Claims in a test suite: pytest collects ``*.claims.toml``."""
