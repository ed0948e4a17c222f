"""The command line. Each command calls one function of the library, and its result is shown."""

from __future__ import annotations

__all__ = ["main"]


def main() -> None:
    """Run the ``pc2scan`` command."""
    import signal

    # Ctrl-C while modules are loaded ends the process without a traceback.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    import gc
    import os
    import sys

    # No garbage collection while modules are loaded: they make many objects and no garbage, and looking for garbage
    # takes a twentieth of start-up.
    gc.set_threshold(100_000)

    # No threads for NumPy's linear algebra: nothing here uses them, and to start them takes longer than to convert
    # a small recording.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from pc2scan.errors import UsageError

    from .app import run
    from .failures import end_without_output, show_failure
    from .render import StdoutError

    # A daemon may start a process without these. An output, and what workers inherit, must not get their numbers.
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            stream = open(os.devnull, "r" if name == "stdin" else "w", encoding="utf-8")  # noqa: PTH123, SIM115
            os.set_inheritable(stream.fileno(), True)
            setattr(sys, name, stream)
    if lost := next((word for word in sys.argv if word.startswith("memory:")), None):
        error = UsageError("is in the memory of this process, and gone when it ends", path=lost)
        sys.exit(show_failure(error, sys.argv[1:]))
    try:
        sys.exit(run(sys.argv[1:]))
    except StdoutError as err:
        sys.exit(end_without_output(err.args[0], sys.argv[1:]))
    finally:
        # Skip the interpreter's last garbage collection: it takes a fifth of a short run.
        gc.freeze()
