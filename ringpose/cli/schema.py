"""`ringpose schema`: the JSON Schemas of the records that are written."""

from typing import Annotated

import typer

from ringpose.cli.app import app

NAMES = ("pose", "track", "detection", "truth", "session")

SchemaName = Annotated[
    str | None, typer.Argument(metavar="NAME", help=f"One of {', '.join(NAMES)}; without it they are listed.")
]


@app.command()
def schema(name: SchemaName = None) -> None:
    """Print the JSON Schema of a record, or the names of all."""
    from importlib.resources import files

    from ringpose.errors import UsageError
    from ringpose.files import records
    from ringpose.files.schema import hint

    if name is None:
        records.write_text("".join(f"{each}\n" for each in NAMES))
    elif name in NAMES:
        records.write_text(files("ringpose.files").joinpath(f"{name}.schema.json").read_text(encoding="utf-8"))
    else:
        remedy = hint(name, NAMES) or f"give one of {', '.join(NAMES)}"
        raise UsageError("", f"there is no schema of {name!r:.60}", remedy)
