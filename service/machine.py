"""What a figure was measured on: machine and versions, for reports, benchmarks and sessions."""

import os
import platform
import resource
from importlib.metadata import version
from pathlib import Path

MEASURED_PACKAGES = (
    "appearance-rig", "numpy", "scipy", "numba", "opencv-contrib-python-headless", "rawpy", "zarr", "moderngl",
)  # fmt: skip


def machine() -> dict[str, object]:
    """Processor, cores, memory and system in the words of the machine itself."""
    pages, page_bytes = os.sysconf("SC_PHYS_PAGES"), os.sysconf("SC_PAGE_SIZE")
    return {
        "processor": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "memory_gb": round(pages * page_bytes / 1e9, 1),
        "system": platform.platform(terse=True),
        "python": platform.python_version(),
    }


def versions() -> dict[str, str]:
    """Versions of this product and of the packages that figures depend on."""
    return {name: version(name) for name in MEASURED_PACKAGES}


def peak_memory_gb() -> float:
    """The largest resident memory so far of this process and of its largest child."""
    # Of itself ru_maxrss would tell the peak of whoever started it, too: Linux carries that over a process's start.
    status = Path("/proc/self/status").read_text(encoding="ascii")
    own_kb = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM:"))
    return (own_kb + resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss) / 1e6
