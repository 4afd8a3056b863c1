"""The program `lfmesh`: commands are added to `app`; `main` runs one and turns its outcome into an exit code."""

import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import cyclopts
from cyclopts import App, Group, Parameter

import lfmesh
from lfmesh.cli.interrupts import code_of_last, terminate_as_interrupt
from lfmesh.cli.printing import warnings_in_words
from lfmesh.cli.tasks import TASKS
from lfmesh.errors import LfmeshError
from lfmesh.wrapping import wrapped

CASE_FAILED = 1
WRONG_INPUT = 2
BROKEN_PIPE = 141
"""128 + SIGPIPE."""

app = App(
    name="lfmesh",
    help="Simulate light-field cameras physically: glass as triangle meshes, raw images with error bars.",
    help_format="plaintext",
    group_commands=Group("Options", sort_key=len(TASKS)),  # --help and --version alone: commands have headings
    default_parameter=Parameter(negative=()),  # no --empty-counts beside --counts
    version=lambda: lfmesh.__version__,
    result_action="return_value",
    suppress_keyboard_interrupt=False,
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        Arguments of the process if omitted.

    Returns
    -------
    int
        Exit code: 0; 2 for wrong input (one message on standard error); 128 plus the signal's number if a signal ended
        the command, so 130 after Ctrl-C.
    """
    _open_streams()
    try:
        with terminate_as_interrupt(), warnings_in_words():
            code = app(arguments, exit_on_error=False, print_error=False)
        sys.stdout.flush()
        return code if isinstance(code, int) else 0
    except cyclopts.CycloptsError as error:
        command = " ".join(["lfmesh", *(error.command_chain or ())])
        return _complain(f"{_one_paragraph(str(error))}\nSee: {command} --help")
    except LfmeshError as error:
        return _complain(str(error))
    except KeyboardInterrupt:
        with suppress(OSError):  # of a terminal that was closed
            print("\nStopped before anything was finished; nothing was written.", file=sys.stderr)
        return code_of_last()
    except MemoryError as error:
        return _complain(f"not enough memory: {_one_paragraph(str(error)) or 'nothing more can be allocated'}")
    except BrokenPipeError:
        # Our reader went away, as in `lfmesh schema | head`.
        _give_up_output()
        return BROKEN_PIPE
    except OSError as error:
        if error.filename is None:
            _give_up_output()
        where = "standard output" if error.filename is None else str(error.filename)
        return _complain(f"{where}: cannot be written or read: {error.strerror or error}")


def stopped(out: Path, done: int, things: str) -> int:
    """Print the number of finished things that an interrupted command has kept; return its exit code."""
    if done:
        kept = f"{done} {things if done > 1 else things.removesuffix('s')} kept in {out}; the same command continues."
    else:
        kept = f"none of its {things} is finished; the same command begins with the first."
    print("\n" + wrapped(f"Stopped: {kept}"), file=sys.stderr)
    return code_of_last()


def _open_streams() -> None:
    """Make printing safe: send closed streams to the null device, and escape characters that a stream cannot encode."""
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            # Otherwise the next file opened would get this number, and everything that libraries print.
            os.open(os.devnull, os.O_RDWR)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115  # for the whole process
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _give_up_output() -> None:
    """Send standard output to the null device, so that Python's flush at exit does not fail again."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _complain(message: str) -> int:
    with suppress(OSError):
        print(f"lfmesh: {message}", file=sys.stderr, flush=True)
    return WRONG_INPUT


def _one_paragraph(text: str) -> str:
    return " ".join(text.split())
