"""The most memory that a child process of a test has taken."""

from pathlib import Path

SAYS_PEAK = Path("/proc/self/status").is_file()
"""Whether the system says the peak of a program alone: what `wait4` and `getrusage` say includes its parent."""

PRINT_PEAK = """
with open("/proc/self/status") as status:
    print(next(line.split()[1] for line in status if line.startswith("VmHWM")))
"""
"""Python that prints it, in KiB; the last lines of what a child runs."""
