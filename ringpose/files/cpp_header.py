"""A C++17 header that reads lines, generated from their JSON Schemas, so that its keys are theirs.

It needs nlohmann/json, which every distribution has and which reports the place of an error; a line of 18 kB is parsed
in a tenth of a millisecond, so that a faster parser would change nothing.
"""

import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

from ringpose.files.io import software

Schema = Mapping[str, Any]

LINES = {"pose": "PoseLine", "track": "TrackLine"}
"""The class of each kind of line that is read, by the name of its schema."""

_SCALARS = {"number": "double", "integer": "std::int64_t", "boolean": "bool", "string": "std::string"}

_WIDTH = 110


def cpp_header(schemas: Mapping[str, Schema]) -> str:
    """The header for the schemas of `LINES`, by their names."""
    structs: dict[str, Schema] = {}
    for name, line in LINES.items():
        for part, schema in {**_by_dependency(schemas[name]["$defs"]), line: schemas[name]}.items():
            if structs.setdefault(part, schema) != schema:
                raise ValueError(f"two records have different parts of the name {part}")
    declared = "".join(_struct(name, schema) for name, schema in structs.items())
    defined = "".join(_reader(name, schema) for name, schema in structs.items())
    choices = "".join(
        f'  if (schema == "{schemas[name]["title"]}") return read_as<{line}>(line);\n' for name, line in LINES.items()
    )
    known = " or ".join(schemas[name]["title"] for name in LINES)
    return (
        _HEAD.replace("SOFTWARE", software())
        + declared
        + f"/// A line of either command.\nusing Line = std::variant<{', '.join(LINES.values())}>;\n\n"
        + _READERS
        + defined
        + _TAIL.replace("CHOICES", choices).replace("KNOWN", known)
    )


def _by_dependency(definitions: Mapping[str, Schema]) -> dict[str, Schema]:
    """The parts of a record, each after those that it consists of."""
    ordered: dict[str, Schema] = {}

    def add(name: str) -> None:
        for part in _references(definitions[name]):
            add(part)
        ordered.setdefault(name, definitions[name])

    for name in definitions:
        add(name)
    return ordered


def _references(schema: Any) -> Iterator[str]:
    """Names of the parts to which a schema refers."""
    if isinstance(schema, Mapping):
        if "$ref" in schema:
            yield schema["$ref"].rpartition("/")[2]
        for value in schema.values():
            yield from _references(value)
    elif isinstance(schema, list):
        for value in schema:
            yield from _references(value)


def _struct(name: str, schema: Schema) -> str:
    """A class with one member for each key."""
    lines = [] if "description" not in schema else _comment(schema["description"], "")
    lines.append(f"struct {name} {{")
    for key, value in schema["properties"].items():
        words = [value["description"]] if "description" in value else []
        if "enum" in value:
            words.append("One of: " + ", ".join("null" if word is None else word for word in value["enum"]) + ".")
        lines += _comment(" ".join(words), "  ")
        lines.append(f"  {_member_type(value, needed=key in schema['required'])} {key}{{}};")
    return "\n".join([*lines, "};", "", ""])


def _comment(text: str, indent: str) -> list[str]:
    prefix = f"{indent}/// "
    return textwrap.wrap(text, _WIDTH, initial_indent=prefix, subsequent_indent=prefix)


def _reader(name: str, schema: Schema) -> str:
    """The function that reads an object of the class."""
    keys = "".join(f'  read_key(value, "{key}", out.{key}, place);\n' for key in schema["properties"])
    return (
        f"inline void read_value(const Json& value, {name}& out, const std::string& place) {{\n"
        f'  require(value.is_object(), value, place, "an object");\n{keys}}}\n\n'
    )


def _member_type(schema: Schema, *, needed: bool) -> str:
    """The type of a key's value; a key that may be missing is optional."""
    value = _type(schema)
    return value if needed or value.startswith("std::optional") else f"std::optional<{value}>"


def _type(schema: Schema) -> str:
    """The C++ type of a value; what may be null is optional."""
    if "anyOf" in schema:
        some = [each for each in schema["anyOf"] if each != {"type": "null"}]
        types = [_type(each) for each in some]
        value = types[0] if len(types) == 1 else f"std::variant<{', '.join(types)}>"
        return value if len(some) == len(schema["anyOf"]) else f"std::optional<{value}>"
    if "$ref" in schema:
        return str(schema["$ref"]).rpartition("/")[2]
    if "const" in schema:
        return "std::vector<std::string>" if isinstance(schema["const"], list) else "std::string"
    if "enum" in schema:
        return "std::optional<std::string>" if None in schema["enum"] else "std::string"
    if isinstance(schema["type"], list):
        kind = next(each for each in schema["type"] if each != "null")
        return f"std::optional<{_type({**schema, 'type': kind})}>"
    if schema["type"] == "array":
        item, count = _type(schema["items"]), schema.get("minItems")
        fixed = count is not None and count == schema.get("maxItems")
        return f"std::array<{item}, {count}>" if fixed else f"std::vector<{item}>"
    if schema["type"] == "object":
        return f"std::map<std::string, {_type(schema['additionalProperties'])}>"
    return _SCALARS[schema["type"]]


_HEAD = """\
// Reads the lines of `ringpose pose` and `ringpose track` in C++17. Written by `ringpose schema --cpp` of SOFTWARE from
// the JSON Schemas of the lines: write it anew for another version, never change it.
//
// It needs nlohmann/json 3 (apt install nlohmann-json3-dev). Lengths in metres, angles in radians, times in seconds.
// What may be null or missing is a std::optional; keys and flags that are not known are ignored. The manual page
// ringpose-records(5) describes each key, ringpose-robot(7) what a controller may do with a line.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include <nlohmann/json.hpp>

namespace ringpose {

using Json = nlohmann::json;

/// What is wrong with a line, after the key that it concerns.
struct Error : std::runtime_error {
  using std::runtime_error::runtime_error;
};

"""

_READERS = """\
inline void require(bool holds, const Json& value, const std::string& place, const std::string& expected) {
  if (!holds) throw Error(place + ": is " + value.type_name() + ", must be " + expected);
}

inline void read_value(const Json& value, double& out, const std::string& place) {
  require(value.is_number(), value, place, "a number");
  out = value.get<double>();
}

inline void read_value(const Json& value, std::int64_t& out, const std::string& place) {
  require(value.is_number_integer(), value, place, "a whole number");
  out = value.get<std::int64_t>();
}

inline void read_value(const Json& value, bool& out, const std::string& place) {
  require(value.is_boolean(), value, place, "true or false");
  out = value.get<bool>();
}

inline void read_value(const Json& value, std::string& out, const std::string& place) {
  require(value.is_string(), value, place, "a text");
  out = value.get<std::string>();
}

template <class T> void read_value(const Json& value, std::optional<T>& out, const std::string& place);
template <class T> void read_value(const Json& value, std::vector<T>& out, const std::string& place);
template <class T> void read_value(const Json& value, std::map<std::string, T>& out, const std::string& place);
template <class T> void read_value(const Json& value, std::variant<std::string, T>& out, const std::string& place);
template <class T, std::size_t N> void read_value(const Json& value, std::array<T, N>& out, const std::string& place);

template <class T> void read_value(const Json& value, std::optional<T>& out, const std::string& place) {
  out.reset();
  if (!value.is_null()) read_value(value, out.emplace(), place);
}

template <class T> void read_value(const Json& value, std::vector<T>& out, const std::string& place) {
  require(value.is_array(), value, place, "a list");
  out.assign(value.size(), T{});
  for (std::size_t i = 0; i < out.size(); ++i) read_value(value[i], out[i], place + "[" + std::to_string(i) + "]");
}

template <class T, std::size_t N> void read_value(const Json& value, std::array<T, N>& out, const std::string& place) {
  require(value.is_array() && value.size() == N, value, place, "a list of " + std::to_string(N));
  for (std::size_t i = 0; i < N; ++i) read_value(value[i], out[i], place + "[" + std::to_string(i) + "]");
}

template <class T> void read_value(const Json& value, std::map<std::string, T>& out, const std::string& place) {
  require(value.is_object(), value, place, "an object");
  out.clear();
  for (const auto& item : value.items()) read_value(item.value(), out[item.key()], place + "." + item.key());
}

template <class T> void read_value(const Json& value, std::variant<std::string, T>& out, const std::string& place) {
  if (value.is_string()) out = value.get<std::string>();
  else read_value(value, out.template emplace<1>(), place);
}

template <class T> struct is_optional : std::false_type {};
template <class T> struct is_optional<std::optional<T>> : std::true_type {};

template <class T> void read_key(const Json& object, const char* key, T& out, const std::string& place) {
  const std::string where = place.empty() ? key : place + "." + key;
  const auto found = object.find(key);
  if (found != object.end()) read_value(*found, out, where);
  else if constexpr (is_optional<T>::value) out.reset();
  else throw Error(where + ": is missing");
}

"""

_TAIL = """\
template <class T> T read_as(const Json& line) {
  T out;
  read_value(line, out, "");
  return out;
}

/// The line in a text, which is one JSON object; throws Error.
inline Line read_line(const std::string& text) {
  Json line;
  try {
    line = Json::parse(text);
  } catch (const Json::exception& error) {
    throw Error(std::string("is not JSON: ") + error.what());
  }
  if (!line.is_object()) throw Error(std::string("is ") + line.type_name() + ", must be an object");
  std::string schema;
  read_key(line, "schema", schema, "");
CHOICES  throw Error("schema: is " + schema + ", must be KNOWN");
}

}  // namespace ringpose
"""
