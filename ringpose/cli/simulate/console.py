"""`ringpose simulate console`: the simulation platform in the browser."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli.app import OUTPUT, file_option
from ringpose.cli.pages import PagePort, announce

if TYPE_CHECKING:
    from ringpose.console.engine import ConsolePicture
    from ringpose.console.state import ConsoleState, Trajectory

SceneFile = Annotated[Path, typer.Argument(metavar="SCENE", help="The scene (scene.yaml).")]
Width = Annotated[
    int, typer.Option("--width", metavar="PX", min=160, max=4096, help="Width of the measurement camera's images.")
]
RecordFolder = Annotated[
    Path | None,
    file_option("--output", "-o", metavar="DIR", meaning="Folder for recorded shots and their truth.", purpose=OUTPUT),
]
Overwrite = Annotated[bool, typer.Option("--force", help="Replace an earlier recording.", rich_help_panel=OUTPUT)]


def console(
    scene: SceneFile, port: PagePort = None, width: Width = 640, output: RecordFolder = None, force: Overwrite = False
) -> None:
    """Steer target, camera, lasers and light in the browser, and watch the measurement, until a signal ends it."""
    from dataclasses import replace
    from importlib.util import find_spec

    from ringpose.errors import UsageError
    from ringpose.files import records
    from ringpose.files.images.simulations import SimulationFolder
    from ringpose.files.rigs import rig_in
    from ringpose.files.scenes.copies import write_scene_copy
    from ringpose.files.scenes.scene import read_scene

    if find_spec("viser") is None:
        raise UsageError("simulate console", "viser is not installed", "pip install 'ringpose[console]'")
    read = read_scene(scene)
    from ringpose.console.page import ConsolePage
    from ringpose.simulate.serve.preview import preview

    folder = None if output is None else SimulationFolder(output, preview(read, width).rig, force=force, inputs=[scene])

    def record(picture: "ConsolePicture") -> None:
        if folder is not None and picture.shot is not None and picture.shot_truth is not None:
            records.write_name(folder.add(picture.shot, picture.shot_truth))

    def save(state: "ConsoleState") -> str:
        shown = replace(state, width=None).scene_of(read)
        target = Path(output or ".") / f"saved_{state.number:06d}"
        path = write_scene_copy(
            target, scene, shown.rig, state.view(read), state.light, shown.sequence, state.exposure_s,
            shown.sensor.pixel_m if shown.sensor.pixel_m != read.sensor.pixel_m else None,
        )  # fmt: skip
        return str(path)

    on_record, on_save = (None, None) if folder is None else (record, save)
    with ConsolePage(read, "127.0.0.1", port, width, trajectory_in, rig_in, on_record, on_save) as page:
        announce(page.port, port)
        page.serve()


def trajectory_in(content: bytes, name: str) -> "Trajectory":
    """The poses of a file of JSON lines with `center_m` and `normal`, such as truth.jsonl.

    Their times are taken from `stamp_s`; if a line has no stamp, all poses are 0.1 s apart.
    """
    import io

    import numpy as np

    from ringpose.console.state import Trajectory
    from ringpose.errors import DataError
    from ringpose.files import records
    from ringpose.files.inputs import limited_lines
    from ringpose.files.schema import Fields
    from ringpose.types.plausible import TARGET_DISTANCE_M

    lines = limited_lines(io.BytesIO(content), name)
    entries = [Fields(location, record) for location, record in records.read(lines, name)]
    entries = [entry for entry in entries if entry.has("center_m") and entry.has("normal")]
    if not entries:
        raise DataError(name, "has no poses", "give JSON lines with center_m and normal, such as truth.jsonl")
    is_stamped = all(entry.has("stamp_s") for entry in entries)
    stamps = [entry.number("stamp_s") if is_stamped else 0.1 * k for k, entry in enumerate(entries)]
    time_s = np.array(stamps, dtype=np.float64) - stamps[0]
    if (np.diff(time_s) <= 0).any():
        raise DataError(name, "is not in chronological order: stamp_s must increase")
    return Trajectory(
        time_s=time_s,
        center_m=np.array([entry.sized("center_m", TARGET_DISTANCE_M) for entry in entries]),
        normal=np.array([entry.unit_vector("normal") for entry in entries]),
    )
