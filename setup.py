"""The C kernels: everything else about the package stands in pyproject.toml."""

from pathlib import Path

from setuptools import Extension, setup

KERNELS = Path("ringpose/kernels")


def kernels(name: str, parts: tuple[str, ...], headers: tuple[str, ...] = ()) -> Extension:
    """One extension module of `ringpose.kernels` through the stable ABI."""
    return Extension(
        f"ringpose.kernels.{name}",
        sources=[str(next(KERNELS.rglob(f"{part}.c"))) for part in (name, *parts)],
        include_dirs=[str(KERNELS), *(str(each) for each in KERNELS.iterdir() if each.is_dir())],
        depends=[str(each) for each in KERNELS.rglob("*.h")],
        define_macros=[("Py_LIMITED_API", "0x030B0000")],
        py_limited_api=True,
        # No fused multiply-add: the same numbers on every machine. Nobody asks for floating-point traps or errno,
        # without which loops with roots and choices become vectors.
        extra_compile_args=[
            *("-std=c99", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"),
            *("-Wall", "-Wextra"),
        ],
    )


setup(
    ext_modules=[
        kernels("_kernels", ("chains", "cuts", "fits", "gradient", "joins", "lists"), ("buffers", "kernels")),
        kernels(
            "_edges",
            ("edge_arcs", "edge_fit", "edge_places", "edge_steps", "lens"),
            ("buffers", "edges", "kernels", "tracks"),
        ),
        kernels(
            "_faces",
            ("arcs", "candidates", "groups", "lists", "unions"),
            ("arcs", "buffers", "faces", "kernels", "track_line", "tracks"),
        ),
        kernels(
            "_ring",
            (
                *("arcs", "end_fits", "end_levels", "end_places", "end_sigmas", "end_widths", "ends", "flat_ends"),
                *("lens", "marks", "profile", "sections", "track_lines", "track_spills", "tracks"),
            ),
            (
                *("arcs", "buffers", "drafts", "end_fits", "end_levels", "end_places", "end_sigmas", "end_widths"),
                *("ends", "kernels", "marks", "minimum", "normal_cdf", "profile", "sections", "select"),
                *("track_line", "tracks"),
            ),
        ),
        kernels(
            "_stripes",
            (
                "lists",
                "stripe_centers",
                "stripe_columns",
                "stripe_links",
                "stripe_noise",
                "stripe_patches",
                "stripe_ridges",
                "stripe_search",
                "stripe_sigmas",
                "stripe_weights",
            ),
            ("buffers", "kernels", "stripe_columns", "stripes", "cholesky"),
        ),
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
