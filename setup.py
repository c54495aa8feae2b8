"""The C kernels: everything else about the package stands in pyproject.toml."""

from setuptools import Extension, setup

setup(
    ext_modules=[
        Extension(
            "ringpose.kernels._kernels",
            sources=[
                "ringpose/kernels/_kernels.c",
                "ringpose/kernels/chains.c",
                "ringpose/kernels/cuts.c",
                "ringpose/kernels/fits.c",
                "ringpose/kernels/gradient.c",
                "ringpose/kernels/lists.c",
            ],
            depends=["ringpose/kernels/kernels.h"],
            define_macros=[("Py_LIMITED_API", "0x030B0000")],
            py_limited_api=True,
            # No fused multiply-add: the kernels equal their Python twins to the last bit.
            extra_compile_args=["-std=c99", "-O3", "-ffp-contract=off", "-Wall", "-Wextra"],
        )
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
