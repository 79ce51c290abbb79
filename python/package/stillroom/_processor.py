"""Looks at the processor before the compiled module is loaded, all of which is compiled for AVX2 on x86-64."""

import platform
from pathlib import Path


def _lacks_avx2(cpuinfo: str) -> bool:
    """Whether /proc/cpuinfo lists what the processor can do, and AVX2 is not in it."""
    flags = next((line for line in cpuinfo.splitlines() if line.startswith("flags")), "")
    return bool(flags) and "avx2" not in flags.split()


if platform.machine() == "x86_64":
    try:
        _cpuinfo = Path("/proc/cpuinfo").read_text()
    except OSError:
        _cpuinfo = ""
    if _lacks_avx2(_cpuinfo):
        raise ImportError(
            "stillroom needs a processor with AVX2 (2015 or later); in a virtual machine, let the guest see the host's"
            " processor"
        )
