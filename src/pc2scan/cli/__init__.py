"""The command line: each command is a module that parses, calls one function of the library, and shows the result."""

from __future__ import annotations

__all__ = ["main"]


def main() -> None:
    """Run the ``pc2scan`` command."""
    from .interrupts import quiet_interrupts

    with quiet_interrupts():
        _run()


def _run() -> None:
    import gc
    import os
    import sys

    # Loading modules makes many objects and no garbage: looking for some now and then takes a twentieth of start-up.
    gc.set_threshold(100_000)

    # NumPy's linear algebra would start threads, which takes longer than many a conversion, and nothing here uses them.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from .app import application
    from .failures import StdoutError, end_without_output, guarded
    from .memory import keep_freed_memory

    keep_freed_memory()
    sys.stdout = guarded(sys.stdout)
    try:
        application(*sys.argv[1:2])(prog_name="pc2scan")
    except StdoutError as err:
        sys.exit(end_without_output(err.args[0], sys.argv[1:]))
    finally:
        # Before it ends, the interpreter would look for garbage in all that was loaded: a fifth of a short run.
        gc.freeze()
