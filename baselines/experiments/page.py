"""All that a finished experiment shows: tables, figures, and one page that holds everything."""

from pathlib import Path


def write_outputs(run: Path) -> list[Path]:
    """Write every table, figure and the page of a finished run; see docs/experiments_output.md."""
    return []
