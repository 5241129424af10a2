"""`report.html`: everything of one run on a page that opens from the disk, without a network."""

from pdcd.pages.report.write import write

__all__ = ["write"]
