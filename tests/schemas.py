"""JSON Schemas of the package, and records that are checked against them."""

import jsonschema

from ringpose.cli.schema import json_schemas

SCHEMAS = {name: schema() for name, schema in json_schemas().items()}
_VALIDATORS = {name: jsonschema.Draft202012Validator(schema) for name, schema in SCHEMAS.items()}


def validated(record: dict, name: str | None = None) -> dict:
    """The record, which fits the schema of that name, by default that of its own kind."""
    _VALIDATORS[name or record["schema"].split("/")[1]].validate(record)
    return record
