"""The command `vcavity`: fit a measurement, predict one, list materials.

Exit status: 0 it worked (for a fit: it converged and the parameters are identifiable); 1 the fit gives no
trustworthy answer; 2 bad input, told in one line on standard error; 130 interrupted; 141 nobody reads the
output.
"""

import importlib
import os
import sys
from collections.abc import Sequence
from contextlib import suppress

from fitting.cli import arguments, messages

NO_ANSWER, BAD_INPUT, INTERRUPTED, BROKEN_PIPE = 1, 2, 130, 141


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: the words after `vcavity`; those of the process if None.

    Returns:
        The exit status.
    """
    for stream in (sys.stdout, sys.stderr):
        # A terminal without Unicode shows "?" for "±", and no traceback.
        with suppress(AttributeError, ValueError):
            stream.reconfigure(errors="replace")  # type: ignore[union-attr]
    try:
        status = _run(argv)
        sys.stdout.flush()
    except BrokenPipeError:
        _leave_pipe()
        return BROKEN_PIPE
    except KeyboardInterrupt:
        print("vcavity: interrupted", file=sys.stderr)
        return INTERRUPTED
    except (OSError, ValueError) as error:
        print(f"vcavity: {messages.one_line(messages.in_options(messages.described(error)))}", file=sys.stderr)
        return BAD_INPUT
    return status


def _run(argv: Sequence[str] | None) -> int:
    try:
        given = arguments.parser().parse_args(argv)
    except SystemExit as leave:  # --help and --version, which argparse ends so
        return int(leave.code or 0)
    import jax

    jax.config.update("jax_enable_x64", True)
    _remember_programs()
    # Only the command that runs is imported.
    return int(importlib.import_module(f"fitting.cli.{given.command}").run(given))


def _remember_programs() -> None:
    """Keep what is compiled for the next call, unless the user has chosen a place or none."""
    import jax

    chosen = getattr(jax.config, "jax_compilation_cache_dir", None)
    if chosen or not getattr(jax.config, "jax_enable_compilation_cache", True):
        return
    folder = os.path.join(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "vcavity")
    with suppress(OSError):
        os.makedirs(folder, exist_ok=True)
        if os.access(folder, os.W_OK):
            jax.config.update("jax_compilation_cache_dir", folder)
            jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


def _leave_pipe() -> None:
    """Send what is still buffered nowhere: Python would complain about it when it exits."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
