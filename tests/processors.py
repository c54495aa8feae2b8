"""Run the tests as on another x86-64 processor: `python tests/processors.py baseline|other [arguments of pytest]`.

Libraries choose their code by the processor, and each choice rounds differently: the C library's functions with or
without fused multiply-add, the kernels of BLAS, the vector loops of NumPy and OpenCV. `baseline` takes what a processor
without AVX has, `other` what one with a vector unit other than this machine's has. Environment variables choose, so
that processes that the tests start run in the same way.
"""

import os
import platform
import subprocess
import sys
from collections.abc import Callable, Mapping

USED = """
import cv2, numpy
print(*numpy.show_config(mode="dicts")["SIMD Extensions"].get("found", ()))
print(*(name[1:] for name in cv2.getCPUFeaturesLine().split() if name[0] == "*" and name[-1] != "?"))
"""


def vector_units(environment: Mapping[str, str]) -> tuple[list[str], list[str]]:
    """What NumPy and OpenCV can use of this processor beyond what they are compiled for, by their own names."""
    numpy, cv = output([sys.executable, "-c", USED], environment).splitlines()
    return numpy.split(), cv.split()


def blas_cores(environment: Mapping[str, str]) -> set[str]:
    """The kernels that the BLAS of NumPy and that of SciPy report."""
    words = [sys.executable, "-c", "import numpy, scipy.linalg"]
    lines = output(words, {**environment, "OPENBLAS_VERBOSE": "2"}).splitlines()
    return {line.removeprefix("Core: ") for line in lines if line.startswith("Core: ")}


def output(words: list[str], environment: Mapping[str, str]) -> str:
    done = subprocess.run(
        words, env={**environment}, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=True
    )
    return done.stdout


def baseline(numpy: list[str], cv: list[str]) -> dict[str, str]:
    return {
        "OPENBLAS_CORETYPE": "Nehalem",
        "NPY_DISABLE_CPU_FEATURES": " ".join(numpy),
        "OPENCV_CPU_DISABLE": ",".join(cv),
        "OPENCV_IPP": "sse42",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4",
    }


def other(numpy: list[str], cv: list[str]) -> dict[str, str]:
    """Haswell (256 bits, fused multiply-add) where the processor has 512, else Sandybridge (256 bits, not fused)."""
    wide = any("AVX512" in name for name in cv)
    without = ("AVX512", "X86_V4") if wide else ("AVX512", "AVX2", "FMA3", "X86_V4", "X86_V3")
    return {
        "OPENBLAS_CORETYPE": "Haswell" if wide else "Sandybridge",
        "NPY_DISABLE_CPU_FEATURES": " ".join(name for name in numpy if name.startswith(without)),
        "OPENCV_CPU_DISABLE": ",".join(name for name in cv if name.startswith(without)),
        "OPENCV_IPP": "avx2" if wide else "sse42",
    }


PROCESSORS: dict[str, Callable[[list[str], list[str]], dict[str, str]]] = {"baseline": baseline, "other": other}


def main(name: str, *words: str) -> None:
    if platform.machine() != "x86_64":
        sys.stderr.write(f"processors: {name}: there are other processors for x86-64 only: nothing was run\n")
        return
    changes = PROCESSORS[name](*vector_units(os.environ))
    environment = os.environ | changes
    sys.stderr.write(" ".join(["processors:", *(f"{key}={value!r}" for key, value in changes.items())]) + "\n")
    if blas_cores(environment) != {changes["OPENBLAS_CORETYPE"]}:
        sys.exit(f"processors: BLAS does not take the kernels of {changes['OPENBLAS_CORETYPE']}")
    refused = set(changes["NPY_DISABLE_CPU_FEATURES"].split()), set(changes["OPENCV_CPU_DISABLE"].split(","))
    if any(set(left) & without for left, without in zip(vector_units(environment), refused, strict=True)):
        sys.exit("processors: NumPy or OpenCV uses a vector unit that was to be disabled")
    os.execve(sys.executable, [sys.executable, "-m", "pytest", *words], environment)


if __name__ == "__main__":
    main(*sys.argv[1:])
