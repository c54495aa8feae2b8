"""`ringpose bench detectors`: other people's line detectors and ours on the same images."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli.options import STDOUT, Force, ImageChannel, JsonFile, Quiet

if TYPE_CHECKING:
    from ringpose.bench.detectors import DetectorLine, KnownImage
    from ringpose.cli.batch import Batch

ALL_KINDS = "dark, dim, speckle, saturated, foil, foilbright"

Images = Annotated[
    list[str] | None,
    typer.Argument(metavar="IMAGE...", help="Images or folders of them; - reads names; synthetic ones if not given."),
]
Kinds = Annotated[
    list[str] | None,
    typer.Option("--kind", metavar="KIND", help=f"Synthetic images: {ALL_KINDS}; may be given again."),
]
Seeds = Annotated[int, typer.Option("--seeds", metavar="N", min=1, help="Synthetic images of each kind.")]
Rounds = Annotated[
    int, typer.Option("--rounds", metavar="N", min=1, help="Turns in which each detector is timed on each image.")
]
LinesTruth = Annotated[
    Path | None,
    typer.Option("--lines-truth", metavar="FILE", help="True lines of the image, or a folder of such files (CSV)."),
]
LinesOrigin = Annotated[
    int,
    typer.Option("--lines-origin", metavar="N", min=0, max=1, help="What these call the first pixel; MATLAB says 1."),
]


def detectors(
    images: Images = None,
    kind: Kinds = None,
    seeds: Seeds = 3,
    rounds: Rounds = 5,
    lines_truth: LinesTruth = None,
    lines_origin: LinesOrigin = 0,
    json: JsonFile = None,
    channel: ImageChannel = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Compare line detectors: times on one core relative to EdgeDrawing, errors where truth is known."""
    from ringpose.bench.detectors import compared
    from ringpose.bench.detectors_report import detectors_report, group_table
    from ringpose.cli.batch import Batch
    from ringpose.cli.progress import counted
    from ringpose.errors import UsageError
    from ringpose.files import records
    from ringpose.files.io import write_result
    from ringpose.files.provenance import provenance

    if lines_truth is not None and not images:
        raise UsageError("--lines-truth", "belongs to images, and none is given")
    batch = Batch()
    groups: dict[str, list[KnownImage]] = {}
    if images:
        groups |= _photographs(images, lines_truth, lines_origin, channel and channel.value, batch)
    wanted = kind or ([] if images else ALL_KINDS.split(", "))
    todo = [*groups, *_kinds(wanted)]
    lines: dict[str, list[DetectorLine]] = {}
    for name in counted(todo, "groups", quiet):
        members = groups[name] if name in groups else _synthetic(name, seeds)
        title = _title(name, members)
        apart = "\n" if lines else ""
        lines[title] = compared(members, rounds)
        if json != STDOUT:
            records.write_text(apart + group_table(title, lines[title]))
    if lines and json is not None:
        noted = {**detectors_report(lines), "provenance": provenance(_files(images or []))}
        write_result(json, records.line_of(noted), force=force)
    batch.finish()


def _photographs(
    names: list[str], truth: Path | None, origin: int, channel: str | None, batch: "Batch"
) -> "dict[str, list[KnownImage]]":
    """The images by size: what differs in size is not one group."""
    from ringpose.bench.detectors import KnownImage
    from ringpose.detect.line_segments import eight_bit
    from ringpose.files.images import IMAGE_SUFFIXES, read_image
    from ringpose.files.inputs import inputs
    from ringpose.files.lines import lines_beside, read_lines

    known = []
    for item in batch.good(inputs(names, IMAGE_SUFFIXES)):
        with batch.item():
            path = item if isinstance(item, Path) else Path(item.place)
            lines_px = None if truth is None else read_lines(lines_beside(path, truth), float(origin))
            known.append(KnownImage(image=eight_bit(read_image(path, channel)), lines_px=lines_px))
    return {"images": known} if known else {}


def _kinds(names: list[str]) -> list[str]:
    """The kinds, each checked."""
    from ringpose.bench.stripe_images import Kind
    from ringpose.errors import UsageError

    unknown = [name for name in names if name not in list(Kind)]
    if unknown:
        raise UsageError("--kind", f'there is no kind "{unknown[0]}"', f"there are {', '.join(Kind)}")
    return names


def _synthetic(kind: str, seeds: int) -> "list[KnownImage]":
    from ringpose.bench.detectors import KnownImage
    from ringpose.bench.stripe_images import Kind, stripe_image, stripe_rig

    straight = stripe_rig(lens=False)
    made = [stripe_image(Kind(kind), seed, straight) for seed in range(seeds)]
    return [KnownImage(image=image.image, stripes=image) for image in made]


def _title(name: str, images: "list[KnownImage]") -> str:
    sizes = sorted({image.image.shape[::-1] for image in images})
    return f"{name}: {len(images)} of {', '.join(f'{width} x {height}' for width, height in sizes)} pixels"


def _files(names: list[str]) -> list[Path]:
    """The images whose hashes go into the report."""
    return [Path(name) for name in names if Path(name).is_file()]
