"""Reports: tables, pictures and clouds as one self-contained HTML page, or as Markdown."""

from slbench.report.page import write_page
from slbench.report.parts import Cloud, Page, Part, Picture, Table, Text

__all__ = ["Cloud", "Page", "Part", "Picture", "Table", "Text", "write_page"]
