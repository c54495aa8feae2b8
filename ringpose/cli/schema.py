"""`ringpose schema`: the JSON Schemas of the records that are written."""

from typing import Annotated

import typer

from ringpose.cli.app import app

SchemaName = Annotated[
    str | None, typer.Argument(metavar="NAME", help="Name of a kind of record; without it they are listed.")
]


@app.command()
def schema(name: SchemaName = None) -> None:
    """Print the JSON Schema of a record, or the names of all."""
    import json

    from ringpose.errors import UsageError
    from ringpose.files import records
    from ringpose.files.schema import hint
    from ringpose.files.schemas import NAMES
    from ringpose.files.schemas import schema as json_schema

    if name is None:
        records.write_text("".join(f"{each}\n" for each in NAMES))
    elif name in NAMES:
        records.write_text(json.dumps(json_schema(name), indent=2) + "\n")
    else:
        remedy = hint(name, NAMES) or f"give one of {', '.join(NAMES)}"
        raise UsageError("", f"there is no schema of {name!r:.60}", remedy)
