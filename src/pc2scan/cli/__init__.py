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
    from .memory import keep_freed_memory
    from .screen import Screen, StdoutError

    keep_freed_memory()
    # Either is None where the process was started without it.
    if sys.stdout is not None:
        sys.stdout = Screen(sys.stdout, guarded=True)
    if sys.stderr is not None:
        sys.stderr = Screen(sys.stderr)
    try:
        application(*sys.argv[1:2])(prog_name="pc2scan")
    except StdoutError as err:
        from .failures import end_without_output

        sys.exit(end_without_output(err.args[0], sys.argv[1:]))
    finally:
        # Before it ends, the interpreter would look for garbage in all that was loaded: a fifth of a short run.
        gc.freeze()
