"""Reports: tables, pictures and clouds as one self-contained HTML page, or as Markdown."""

from slbench.report.page import write_page

__all__ = ["write_page"]
