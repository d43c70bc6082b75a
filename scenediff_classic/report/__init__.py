"""Pictures and a page that show a result and the evidence behind it."""

from scenediff_classic.report.overlays import write_overlays
from scenediff_classic.report.page import write_report

__all__ = ["write_overlays", "write_report"]
