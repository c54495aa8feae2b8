"""`ringpose schema`: the JSON Schemas of the records that are written."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Annotated, Any

import typer

from ringpose.cli.app import app

SchemaName = Annotated[
    str | None, typer.Argument(metavar="NAME", help="Name of a kind of record; without it they are listed.")
]
Cpp = Annotated[
    bool, typer.Option("--cpp", help="Print a C++17 header instead that reads the lines of pose and track.")
]


@app.command()
def schema(name: SchemaName = None, cpp: Cpp = False) -> None:
    """Print the JSON Schema of a record, or the names of all."""
    import json

    from ringpose.errors import UsageError
    from ringpose.files import records
    from ringpose.files.schema import hint

    schemas = json_schemas()
    if cpp:
        from ringpose.files.cpp_header import LINES, cpp_header

        if name is not None:
            raise UsageError("--cpp", f"is one header for {' and '.join(LINES)}", "leave out NAME")
        records.write_text(cpp_header({line: schemas[line]() for line in LINES}))
    elif name is None:
        records.write_text("".join(f"{each}\n" for each in schemas))
    elif name in schemas:
        records.write_text(json.dumps(schemas[name](), indent=2) + "\n")
    else:
        remedy = hint(name, schemas) or f"give one of {', '.join(schemas)}"
        raise UsageError("", f"there is no schema of {name!r:.60}", remedy)


def json_schemas() -> Mapping[str, Callable[[], dict[str, Any]]]:
    """The JSON Schemas of what is read, and of what is written only, by name."""
    from ringpose.bench import report
    from ringpose.capture.device_discovery import FoundCamera, SerialPort
    from ringpose.capture.self_test import DeviceCheck
    from ringpose.files.records.codec import RecordType, json_schema
    from ringpose.files.records.ros import RosLine
    from ringpose.files.schemas import RECORDS

    written: Mapping[str, RecordType[Any]] = {
        "bench": report.RECORD,
        "ros": RecordType(cls=RosLine, description="A pose or track line with --format ros: messages of ROS 2."),
        "capture-test": RecordType(cls=DeviceCheck, description="One check of `ringpose capture --test`."),
    }
    devices = partial(json_schema, (FoundCamera, SerialPort), "device", "One device of ringpose capture --list.")
    return {**{name: each.schema for name, each in {**RECORDS, **written}.items()}, "capture-list": devices}
