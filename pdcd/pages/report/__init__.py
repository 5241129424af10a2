"""`report.html`: everything of one run on a page that opens from the disk, without a network."""

from pdcd.pages.report.write import write_report

__all__ = ["write_report"]
