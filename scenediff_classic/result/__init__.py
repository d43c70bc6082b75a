"""The files that hold a result: ``changes.json`` and ``run.json``.

Their fields are documented in ``docs/output.md``; ``changes.schema.json``, in the package's
folder, is the JSON Schema of the first.
"""

from scenediff_classic.result.reading import read_result
from scenediff_classic.result.run import RunInfo, json_ready, write_run
from scenediff_classic.result.writing import SCHEMA_VERSION, write_result

__all__ = ["SCHEMA_VERSION", "RunInfo", "json_ready", "read_result", "write_result", "write_run"]
