"""Shape annotations of the renderer are enforced while testing."""

from jaxtyping import install_import_hook

import tests.typechecking  # noqa: F401  (the hook finds it by name)

install_import_hook("data_tools.synthetic_pairs", "tests.typechecking.checked")
