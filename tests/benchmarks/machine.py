"""The machine that a benchmark runs on: processor, load, versions; and whether its wall-clock times count."""

import hashlib
import os
import platform
import threading
from pathlib import Path
from time import perf_counter, process_time

import cv2
import numpy as np

from ringpose.files.io import version
from ringpose.processes import cores

IDLE_SHARE = 0.9
"""Share of all cores that a process must get for its wall-clock times to be judged."""

_MIB = 1 << 20


def machine() -> str:
    """Processor, cores, load and versions, in one line."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())
    load = " ".join(f"{each:.2f}" for each in os.getloadavg())
    versions = f"Python {platform.python_version()}, NumPy {np.__version__}, OpenCV {cv2.__version__}"
    state = "idle" if is_idle() else "busy: wall-clock times are not judged"
    return f"{model}, {cores()} cores, load {load} ({state}); ringpose {version()}, {versions}"


def is_idle(seconds: float = 0.5) -> bool:
    """Whether this process gets every core for itself: a thread on each computes check sums for a time."""
    data, end_s = bytes(_MIB), perf_counter() + seconds

    def work() -> None:
        while perf_counter() < end_s:
            hashlib.sha256(data)  # without the interpreter's lock

    threads = [threading.Thread(target=work) for _ in range(cores())]
    start_s, start_cpu_s = perf_counter(), process_time()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return process_time() - start_cpu_s > IDLE_SHARE * cores() * (perf_counter() - start_s)
