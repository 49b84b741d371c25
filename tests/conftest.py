"""What holds in every test: float64, strict dtypes, checked shapes, repeatable examples, no window."""

import os

os.environ.setdefault("MPLBACKEND", "Agg")
# Most of the time goes into compiling; what is compiled is the same, only less polished.
os.environ["XLA_FLAGS"] = (
    f"{os.environ.get('XLA_FLAGS', '')} --xla_llvm_disable_expensive_passes=true "
    "--xla_cpu_use_fusion_emitters=false"
).strip()

# A command keeps what it compiles for the next one; a test shall leave nothing behind.
os.environ.setdefault("JAX_ENABLE_COMPILATION_CACHE", "false")

import hypothesis
import jax
import jaxtyping
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")

# Before anything imports the packages: only modules imported from here on are checked.
jaxtyping.install_import_hook(["vcavity_jax", "fitting"], "beartype.beartype")

hypothesis.settings.register_profile("ci", deadline=None, derandomize=True, max_examples=25, print_blob=True)
hypothesis.settings.load_profile("ci")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave the slow tests out, unless the command line chooses by marker."""
    if config.getoption("markexpr"):
        return
    slow = [item for item in items if item.get_closest_marker("slow")]
    items[:] = [item for item in items if item not in slow]
    config.hook.pytest_deselected(items=slow)
