"""Reading, writing and describing records by their one definition: a data class whose fields have a `Key`.

`definition_of(cls)` has a kind of value for each key; each kind reads, writes and describes its values. Messages are
those of `Fields`: place, finding and remedy.

msgspec writes the JSON (`ringpose.files.records`), but does not read it: of an error below a free key, such as
`rig_health.left`, it does not name the key, and it accepts a key that occurs twice.
"""

import types
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import MISSING, dataclass, fields, is_dataclass
from enum import Enum, IntFlag, StrEnum
from functools import cached_property
from math import inf, isfinite
from typing import Annotated, Any, Generic, Literal, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from ringpose.files.io import software
from ringpose.files.records.arrays import Axes, checked_array, fixed_length
from ringpose.files.schema import Fields, Kind
from ringpose.types.arrays import element_and_axes
from ringpose.types.record import REQUIRED, Form, Key, Presence, key_of

T = TypeVar("T")

Flag = TypeVar("Flag", bound=IntFlag)

Schema = dict[str, Any]


class Unknown(Exception):
    """A word of a later version; the entry of a list or mapping that has it is ignored."""


class Context(NamedTuple):
    """What reading depends on beside the definition."""

    unchanged: str = ""
    """Remedy for a record that contradicts itself."""
    strict: bool = False
    """Whether unknown keys are rejected."""


OF_FILE = Context(strict=True)
"""For a file, whose unknown keys are rejected."""


@dataclass(frozen=True)
class Value(ABC):
    """A kind of value, with what its key states."""

    key: Key

    @abstractmethod
    def read(self, fields: Fields, name: str, context: Context, axes: Axes) -> Any:
        """The value of a key that is there and not null."""

    def unknown(self, null: Any) -> Any:
        """The value for null, which stands for `null`."""
        return null

    def takes(self, value: Any) -> bool:
        """Whether a value, as it was read or as it is to be written, is of this type, though perhaps invalid."""
        return isinstance(value, str)

    def write(self, value: Any) -> Any:
        """The value in types of JSON; numbers that are not finite become null when they are encoded."""
        return value

    @abstractmethod
    def schema(self, definitions: Schema) -> Schema:
        """JSON Schema of a value that is not null; `definitions` receives those of data classes."""

    @property
    def is_plain(self) -> bool:
        """Whether values are written as they are."""
        return type(self).write is Value.write

    @property
    def parts(self) -> "tuple[Definition[Any], ...]":
        """The definitions of the data classes that the value is of, or whose objects it lists."""
        return ()


@dataclass(frozen=True)
class Text(Value):
    """A text, not empty unless it may be `blank`."""

    def read(self, fields: Fields, name: str, context: Context, axes: Axes) -> str:
        text = str(fields.raw(name)) if self.key.blank else fields.text(name)
        if self.key.form is Form.FILE_NAME and ("/" in text or text.startswith(".")):
            raise fields.problem(name, f"is {text!r}, must be a plain file name")
        return text

    def write(self, value: str) -> str | None:
        return None if value == self.key.null else value

    @property
    def is_plain(self) -> bool:
        return self.key.null is REQUIRED

    def schema(self, definitions: Schema) -> Schema:
        described: Schema = {"type": "string"} if self.key.blank else {"type": "string", "minLength": 1}
        return described | ({"pattern": self.key.pattern} if self.key.pattern else {})


@dataclass(frozen=True)
class Number(Value):
    """A real or a whole number."""

    whole: bool = False

    def read(self, fields: Fields, name: str, context: Context, axes: Axes) -> float | int:
        key = self.key
        if self.whole:
            return fields.integer(name, key.least, key.most)
        if key.form is Form.STAMP:
            return fields.stamp_s(name)
        if key.plausible is None:
            number = fields.number(name, key.least, key.most)
        else:
            number = fields.quantity(name, key.plausible)
        if key.positive and number <= 0:
            raise fields.problem(name, "must be positive")
        return number

    def takes(self, value: Any) -> bool:
        return isinstance(value, int | float) and not isinstance(value, bool)

    def schema(self, definitions: Schema) -> Schema:
        return {"type": "integer" if self.whole else "number", **_limits(self.key, self.key.least)}


def _limits(key: Key, least: float | int) -> Schema:
    lower: Schema = {"exclusiveMinimum": 0} if key.positive else {"minimum": least} if least > -inf else {}
    return lower | ({"maximum": key.most} if key.most < inf else {})


@dataclass(frozen=True)
class Boolean(Value):
    """True or false."""

    def read(self, fields: Fields, name: str, context: Context, axes: Axes) -> bool:
        return fields.boolean(name)

    def takes(self, value: Any) -> bool:
        return isinstance(value, bool)

    def schema(self, definitions: Schema) -> Schema:
        return {"type": "boolean"}


@dataclass(frozen=True)
class Anything(Value):
    """A text, a number, true or false."""

    def read(self, fields: Fields, name: str, context: Context, axes: Axes) -> str | float | int | bool:
        return fields.scalar(name)

    def schema(self, definitions: Schema) -> Schema:
        return {"type": ["string", "number", "boolean"]}


@dataclass(frozen=True)
class Free(Value):
    """A mapping that is kept as it is."""

    def read(self, fields: Fields, name: str, context: Context, axes: Axes) -> Mapping[str, Any]:
        return fields.fields(name).values

    def schema(self, definitions: Schema) -> Schema:
        return {"type": "object"}


@dataclass(frozen=True)
class Worded(Value):
    """A value of which some, or all, are written as words."""

    rest: Value | None = None
    """Of the values without a word; None if all have one."""

    def read(self, fields: Fields, name: str, context: Context, axes: Axes) -> Any:
        if self.rest is not None and not isinstance(fields.raw(name), str):
            return self.rest.read(fields, name, context, axes)
        word = fields.choice(name, self.key.words.values())
        return next(value for value, each in self.key.words.items() if each == word)

    def write(self, value: Any) -> Any:
        return self.key.words[value] if self.rest is None or value in self.key.words else self.rest.write(value)

    def schema(self, definitions: Schema) -> Schema:
        words: Schema = {"enum": list(self.key.words.values())}
        return words if self.rest is None else {"anyOf": [words, self.rest.schema(definitions)]}

    @property
    def parts(self) -> "tuple[Definition[Any], ...]":
        return () if self.rest is None else self.rest.parts


@dataclass(frozen=True)
class Choice(Value):
    """One of some words or numbers: an enumeration, or literals."""

    words: tuple[Any, ...] = ()
    meaning: Callable[[Any], Any] = str

    def read(self, fields: Fields, name: str, context: Context, axes: Axes) -> Any:
        if isinstance(self.words[0], int):
            number = fields.integer(name)
            if number not in self.words:
                raise fields.problem(name, f"is {number}, must be {' or '.join(map(str, self.words))}")
            return number
        if self.key.grows and fields.text(name) not in self.words:
            raise Unknown
        return self.meaning(fields.choice(name, self.words))

    def schema(self, definitions: Schema) -> Schema:
        return {"enum": list(self.words)}


def flags_by_name(kind: type[Flag]) -> Mapping[str, Flag]:
    """The flags of a kind by their names in lower case."""
    return {str(flag.name).lower(): flag for flag in kind}


@dataclass(frozen=True)
class Flags(Value):
    """Names of flags in lower case; those of later versions are ignored."""

    kind: type[IntFlag] = IntFlag

    def read(self, fields: Fields, name: str, context: Context, axes: Axes) -> IntFlag:
        known, flags = flags_by_name(self.kind), self.kind(0)
        for word in fields.texts(name):
            flags |= known.get(word, self.kind(0))
        return flags

    def write(self, value: IntFlag) -> list[str]:
        return [name for name, bit in self._bits if bit & int(value)]

    @cached_property
    def _bits(self) -> list[tuple[str, int]]:
        return [(name, int(flag)) for name, flag in flags_by_name(self.kind).items()]

    def schema(self, definitions: Schema) -> Schema:
        return {"type": "array", "uniqueItems": True, "items": {"type": "string", "minLength": 1}}


@dataclass(frozen=True)
class Numbers(Value):
    """An array, as nested lists."""

    element: str = "Float64"
    axes: tuple[str, ...] = ()
    whole_or_null: bool = False
    """Whether an array of which some numbers are not finite is null."""

    def read(self, fields: Fields, name: str, context: Context, axes: Axes) -> Any:
        return checked_array(self.key, self.element, self.axes, fields, name, axes, context.unchanged)

    def takes(self, value: Any) -> bool:
        if isinstance(value, np.ndarray):
            return value.ndim == len(self.axes)
        depth = 0
        while isinstance(value, list):
            depth, value = depth + 1, next((each for each in value if isinstance(each, list)), None)
        return depth == len(self.axes)

    def unknown(self, null: Any) -> Any:
        return null if null is None else np.full([fixed_length(axis) or 0 for axis in self.axes], null)

    def write(self, value: Any) -> Any:
        numbers = value.tolist()
        if self.key.null_points:
            return _with_null_points(numbers)
        return None if self.whole_or_null and not _all_finite(numbers) else numbers

    def schema(self, definitions: Schema) -> Schema:
        kind = {"Float64": "number", "Int64": "integer", "Bool": "boolean"}[self.element]
        least = max(self.key.least, 0.0) if self.key.form is Form.SIGMAS else self.key.least
        described: Schema = {"type": [kind, "null"] if self.key.gaps else kind, **_limits(self.key, least)}
        for axis in reversed(self.axes):
            length = fixed_length(axis)
            described = {"type": "array", "items": described}
            described |= {} if length is None else {"minItems": length, "maxItems": length}
            if axis.startswith("xy=") and self.key.null_points:
                described = {"anyOf": [{"type": "null"}, described]}
        return described


def _all_finite(numbers: Any) -> bool:
    """Whether all numbers of nested lists are finite, by their sum: for small ones a tenth of the time NumPy takes."""
    while numbers and isinstance(numbers[0], list):
        numbers = [number for row in numbers for number in row]
    return isfinite(sum(numbers))


def _with_null_points(numbers: Any) -> Any:
    if numbers and not isinstance(numbers[0], list):
        return None if any(number != number for number in numbers) else numbers
    return [_with_null_points(each) for each in numbers]


@dataclass(frozen=True)
class NumberTuple(Numbers):
    """A few numbers, as a tuple."""

    def read(self, fields: Fields, name: str, context: Context, axes: Axes) -> tuple[float, ...]:
        return tuple(super().read(fields, name, context, {}).tolist())

    def takes(self, value: Any) -> bool:
        return isinstance(value, list | tuple)

    def unknown(self, null: Any) -> Any:
        return null

    def write(self, value: tuple[float, ...]) -> list[float]:
        return list(value)


@dataclass(frozen=True)
class Texts(Value):
    """A list of texts."""

    def takes(self, value: Any) -> bool:
        return isinstance(value, list | tuple)

    def read(self, fields: Fields, name: str, context: Context, axes: Axes) -> tuple[str, ...]:
        texts = fields.texts(name)
        if self.key.constant is not None and texts != self.key.constant:
            raise fields.problem(name, f"must be {', '.join(self.key.constant)}", context.unchanged)
        if self.key.form is Form.DISTINCT and ("" in texts or len(set(texts)) < len(texts)):
            raise fields.problem(name, "has an empty name, or one that occurs twice", context.unchanged)
        return texts

    def schema(self, definitions: Schema) -> Schema:
        if self.key.constant is not None:
            return {"const": list(self.key.constant)}
        if self.key.form is Form.DISTINCT:
            return {"type": "array", "uniqueItems": True, "items": {"type": "string", "minLength": 1}}
        return {"type": "array", "items": {"type": "string"}}


@dataclass(frozen=True)
class Items(Value):
    """A list of values of one kind."""

    of: Value

    def read(self, fields: Fields, name: str, context: Context, axes: Axes) -> tuple[Any, ...]:
        listed = fields.listed(name)
        return tuple(self.of.read(listed, each, context, {}) for each in listed.values)

    def takes(self, value: Any) -> bool:
        return isinstance(value, list | tuple)

    def write(self, value: tuple[Any, ...]) -> list[Any]:
        return [self.of.write(each) for each in value]

    def schema(self, definitions: Schema) -> Schema:
        return {"type": "array", "items": self.of.schema(definitions)}

    @property
    def parts(self) -> "tuple[Definition[Any], ...]":
        return self.of.parts


@dataclass(frozen=True)
class OneOf(Value):
    """A value of one of several kinds, which its type tells; a mapping may also be of one of several data classes."""

    kinds: tuple[Value, ...]

    def read(self, fields: Fields, name: str, context: Context, axes: Axes) -> Any:
        given = fields.raw(name)
        kinds = [kind for kind in self.kinds if kind.takes(given)] or [self.kinds[0]]
        kind = kinds[0] if len(kinds) == 1 else self._tagged(fields.fields(name))
        return kind.read(fields, name, context, axes)

    def _tagged(self, fields: Fields) -> Value:
        """The data class of a mapping: that whose tag has its word, or that alone has the tag."""
        tag = self.key.tag
        tags = {kind: kind.of.kind(tag) for kind in self.kinds if isinstance(kind, Object)}
        words = {word: kind for kind, choice in tags.items() if isinstance(choice, Choice) for word in choice.words}
        if words:
            return words[fields.choice(tag, words)]
        return next(kind for kind, choice in tags.items() if (choice is not None) == fields.has(tag))

    def write(self, value: Any) -> Any:
        return next(kind for kind in self.kinds if kind.takes(value)).write(value)

    def schema(self, definitions: Schema) -> Schema:
        return {"anyOf": [kind.schema(definitions) for kind in self.kinds]}

    @property
    def parts(self) -> "tuple[Definition[Any], ...]":
        return tuple(part for kind in self.kinds for part in kind.parts)


@dataclass(frozen=True)
class Objects(Value):
    """A list of objects of a data class."""

    of: "Definition[Any]"

    def read(self, fields: Fields, name: str, context: Context, axes: Axes) -> tuple[Any, ...]:
        return tuple(self._known(fields.each(name), context))

    def _known(self, items: Iterator[Fields], context: Context) -> Iterator[Any]:
        for item in items:
            try:
                yield self.of.read(item, context)
            except Unknown:
                continue

    def write(self, value: tuple[Any, ...]) -> list[Any]:
        return [self.of.write(each) for each in value]

    def schema(self, definitions: Schema) -> Schema:
        return {"type": "array", "items": self.of.reference(definitions)}

    @property
    def parts(self) -> "tuple[Definition[Any], ...]":
        return (self.of,)


@dataclass(frozen=True)
class Object(Value):
    """An object of a data class."""

    of: "Definition[Any]"

    def read(self, fields: Fields, name: str, context: Context, axes: Axes) -> Any:
        return self.of.read(fields.fields(name), context)

    def takes(self, value: Any) -> bool:
        return isinstance(value, Mapping | self.of.cls)

    def write(self, value: Any) -> dict[str, Any]:
        return self.of.write(value)

    def schema(self, definitions: Schema) -> Schema:
        return self.of.reference(definitions)

    @property
    def parts(self) -> "tuple[Definition[Any], ...]":
        return (self.of,)


@dataclass(frozen=True)
class ByName(Value):
    """A mapping of free names to values of one kind."""

    of: "Slot"
    names: type[StrEnum] | None = None
    """The names that there are; None if they are free. Others are of a later version and are ignored."""

    def read(self, fields: Fields, name: str, context: Context, axes: Axes) -> dict[str, Any]:
        values, by_name = fields.fields(name), {}
        if not all(isinstance(key, str) for key in values.values):  # in YAML, `1` is a number
            values = Fields(values.file, {str(key): value for key, value in values.values.items()}, path=values.path)
        for key in values.values:
            if self.names is None or key in tuple(self.names):
                with suppress(Unknown):
                    by_name[self.names(key) if self.names else key] = self.of.read(values, key, context, {})
        return by_name

    def takes(self, value: Any) -> bool:
        return isinstance(value, Mapping)

    def write(self, value: Mapping[Any, Any]) -> dict[str, Any]:
        return {str(name): self.of.write(member) for name, member in value.items()}

    def schema(self, definitions: Schema) -> Schema:
        of = self.of.schema(definitions)
        required = {} if self.names is None else {"required": [str(name) for name in self.names]}
        return {"type": "object", **required, "additionalProperties": of}

    @property
    def parts(self) -> "tuple[Definition[Any], ...]":
        return self.of.value.parts


class Slot(NamedTuple):
    """A value that may be null."""

    value: Value
    null: Any
    """What null stands for; `REQUIRED` if it is an error."""

    def read(self, fields: Fields, name: str, context: Context, axes: Axes) -> Any:
        """The value of a key; what null stands for if it is null or missing."""
        if self.null is not REQUIRED and not fields.has(name):
            return self.value.unknown(self.null)
        return self.value.read(fields, name, context, axes)

    def write(self, value: Any) -> Any:
        """The value in types of JSON."""
        return None if value is None and self.null is None else self.value.write(value)

    def schema(self, definitions: Schema) -> Schema:
        """JSON Schema of a value or null."""
        described = self.value.schema(definitions)
        if self.null is REQUIRED:
            return described
        if set(described) == {"enum"}:
            return {"enum": [*described["enum"], None]}
        if described.get("type") in ("string", "number", "integer", "boolean"):
            return described | {"type": [described["type"], "null"]}
        return {"anyOf": [{"type": "null"}, described]}


def slot_of(annotation: Any, key: Key) -> Slot:
    """The kind of value of a type; `key` states what holds for it."""
    if get_origin(annotation) is Annotated:
        annotation, *more = get_args(annotation)
        key = next((each for each in more if isinstance(each, Key)), key)
    members = get_args(annotation) if get_origin(annotation) in (Union, types.UnionType) else (annotation,)
    null = None if type(None) in members and key.null is REQUIRED else key.null
    value = value_of([each for each in members if each is not type(None)], key, null is not REQUIRED)
    if not key.words:
        return Slot(value, null)
    return Slot(Worded(key, value if any(part.attributes for part in value.parts) else None), REQUIRED)


def value_of(members: list[Any], key: Key, can_be_null: bool) -> Value:
    """The kind of value of a type, or of a union of types."""
    if len(members) > 1 and all(each in (str, float, int, bool) for each in members):
        return Anything(key)
    if len(members) > 1:
        return OneOf(key, tuple(value_of([each], key, can_be_null) for each in members))
    (annotation,) = members
    origin, arguments = get_origin(annotation), get_args(annotation)
    if (array := element_and_axes(annotation)) is not None:
        return Numbers(key, *array, whole_or_null=can_be_null and not key.gaps)
    if origin is tuple:
        return _of_tuple(arguments, key)
    if origin is Literal:
        return Choice(key, arguments)
    if origin is not None and arguments[1] is Any:
        return Free(key)
    if origin is not None:
        return ByName(key, slot_of(arguments[1], Key()), None if arguments[0] is str else arguments[0])
    return _of_class(annotation, key)


def _of_tuple(arguments: tuple[Any, ...], key: Key) -> Value:
    """The kind of value of a tuple: `(float, float)`, or items of one type and an ellipsis."""
    item = arguments[0]
    if item is str:
        return Texts(key)
    if item is float:
        return NumberTuple(key, axes=("n",) if arguments[1] is Ellipsis else (str(len(arguments)),))
    if isinstance(item, type) and is_dataclass(item):
        return Objects(key, definition_of(item))
    return Items(key, slot_of(item, key).value)


def _of_class(cls: type, key: Key) -> Value:
    if is_dataclass(cls):
        return Object(key, definition_of(cls))
    if issubclass(cls, IntFlag):
        return Flags(key, cls)
    if issubclass(cls, Enum):
        return Choice(key, tuple(each.value for each in cls), cls)
    kinds: Mapping[type, Callable[[Key], Value]] = {str: Text, bool: Boolean, float: Number, int: _whole_number}
    return kinds[cls](key)


def _whole_number(key: Key) -> Number:
    return Number(key, whole=True)


class Attribute(NamedTuple):
    """A key of a data class."""

    member: str
    """Name of the field or property ..."""
    name: str
    """... and in the record."""
    slot: Slot
    default: Callable[[], Any] | None
    """Makes the value of a missing key; None if it must be there."""
    is_read: bool
    is_argument: bool
    """Whether the object is made of it."""

    @property
    def key(self) -> Key:
        """What its annotation states."""
        return self.slot.value.key

    def is_default(self, value: Any) -> bool:
        """Whether a value is None or the default of its field."""
        if value is None or isinstance(value, np.ndarray):
            return value is None
        return self.default is not None and bool(value == self.default())

    def read(self, fields: Fields, context: Context, axes: Axes) -> Any:
        """The value in a mapping."""
        given, earlier = fields.values, self.key.earlier
        name = earlier if earlier in given and self.name not in given else self.name
        if self.default is not None and (name not in given or (given[name] is None and self.slot.null is REQUIRED)):
            return self.default()
        return self.slot.read(fields, name, context, axes)


class Writer(NamedTuple):
    """How a key is written; what does not depend on the value is looked up once."""

    member: str
    name: str
    is_omitted: Callable[[Any], bool] | None
    """None if it is always written."""
    write: Callable[[Any], Any] | None
    """None for what is written as it is."""


def _writer(key: Attribute) -> Writer:
    is_omitted = key.is_default if key.key.presence is Presence.IF_KNOWN else None
    return Writer(key.member, key.name, is_omitted, None if key.slot.value.is_plain else key.slot.write)


@dataclass(frozen=True, eq=False)
class Definition(Generic[T]):
    """The keys of a data class in the order of the record."""

    cls: type[T]
    attributes: tuple[Attribute, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """All keys."""
        return tuple(attribute.name for attribute in self.attributes)

    def read(self, fields: Fields, context: Context) -> T:
        """The object in a mapping; `from_record` of its class makes it, if there is one.

        `contradiction` of its class, if there is one, is the key and the finding of values that contradict each other.
        """
        if context.strict and not fields.known:  # else its keys have been looked at
            fields.reject_unknown(self.names)
        axes: Axes = {}
        values = {}
        for attribute in self.attributes:
            if attribute.is_read:
                value = attribute.read(fields, context, axes)
                if attribute.is_argument:
                    values[attribute.member] = value
        make: Callable[..., T] = getattr(self.cls, "from_record", self.cls)
        made = make(**values)
        contradiction: tuple[str, str] | None = getattr(made, "contradiction", None)
        if contradiction is not None:
            key, finding = contradiction
            raise fields.problem(key, finding, context.unchanged)
        return made

    def kind(self, name: str) -> Value | None:
        """The kind of value of a key; None if there is no such key."""
        return next((attribute.slot.value for attribute in self.attributes if attribute.name == name), None)

    def value(self, name: str, fields: Fields) -> Any:
        """The value of one key, in another mapping that has it."""
        return next(attribute for attribute in self.attributes if attribute.name == name).read(fields, Context(), {})

    def write(self, instance: T, brief: bool = False) -> dict[str, Any]:
        """The mapping of an object; with `brief`, without the keys that are then left out."""
        record: dict[str, Any] = {}
        for member, name, is_omitted, write in self.brief_writers if brief else self.writers:
            value = getattr(instance, member)
            if is_omitted is None or not is_omitted(value):
                record[name] = value if write is None else write(value)
        return record

    def values(self, instance: T) -> dict[str, Any]:
        """The values of an object by key, arrays as they are, and those of its parts as mappings."""
        record: dict[str, Any] = {}
        for attribute in self.attributes:
            value, kind = getattr(instance, attribute.member), attribute.slot.value
            if isinstance(kind, Object) and value is not None:
                value = kind.of.values(value)
            record[attribute.name] = kind.write(value) if isinstance(kind, Text) and value is not None else value
        return record

    @cached_property
    def writers(self) -> list[Writer]:
        """How each key is written."""
        return [_writer(attribute) for attribute in self.attributes]

    @cached_property
    def brief_writers(self) -> list[Writer]:
        """How each key of a brief record is written."""
        return [_writer(attribute) for attribute in self.attributes if attribute.key.presence is not Presence.NOT_BRIEF]

    def reference(self, definitions: Schema) -> Schema:
        """Reference to the JSON Schema of an object, which is added to `definitions`."""
        name = self.cls.__name__
        if name not in definitions:
            definitions[name] = self.schema(definitions)
        return {"$ref": f"#/$defs/{name}"}

    def schema(self, definitions: Schema) -> Schema:
        """JSON Schema of a mapping."""
        properties = {}
        for attribute in self.attributes:
            description = attribute.key.description.replace("`", "")
            if isinstance(attribute.slot.value, Flags):
                description += f" {' '.join(flags_by_name(attribute.slot.value.kind))}."
            properties[attribute.name] = attribute.slot.schema(definitions) | (
                {"description": description} if description else {}
            )
        always = [
            attribute
            for attribute in self.attributes
            if attribute.key.presence is Presence.ALWAYS and not attribute.key.added
        ]
        return {"type": "object", "required": [attribute.name for attribute in always], "properties": properties}


_DEFINITIONS: dict[type, Definition[Any]] = {}


def definition_of(cls: type[T]) -> Definition[T]:
    """The definition of a record, or of a part of one."""
    if cls not in _DEFINITIONS:
        _DEFINITIONS[cls] = Definition(cls, _attributes_of(cls))
    return _DEFINITIONS[cls]


def _attributes_of(cls: type) -> tuple[Attribute, ...]:
    """The fields and properties that are keys, in the order of the record."""
    attributes = list(_fields_of(cls))
    for name, member in vars(cls).items():
        if isinstance(member, property):
            hint = get_type_hints(member.fget, include_extras=True).get("return")
            key = key_of(hint)
            if key is not None:
                place = 0 if not key.after else 1 + [attribute.name for attribute in attributes].index(key.after)
                is_read = key.is_read or key.constant is not None
                slot = slot_of(hint, key)
                attributes.insert(place, Attribute(name, key.name or name, slot, None, is_read, key.is_read))
    return tuple(attributes)


def _fields_of(cls: type) -> Iterator[Attribute]:
    hints = get_type_hints(cls, include_extras=True)
    for field in fields(cls):
        key = key_of(hints[field.name])
        if key is not None:
            default = None if field.default_factory is MISSING else field.default_factory
            if field.default is not MISSING:
                default = lambda value=field.default: value  # noqa: E731
            slot = slot_of(hints[field.name], key)
            yield Attribute(field.name, key.name or field.name, slot, None if key.needed else default, True, True)


@dataclass(frozen=True, eq=False, kw_only=True)
class RecordType(Generic[T]):
    """A kind of record, or of file, that is an object of a data class."""

    cls: type[T]
    kind: Kind | None = None
    """What it is in messages; None for what is written and not read."""
    version: str = ""
    """Value of the key `schema`, of a file of the key `ringpose`; empty for a record without one."""
    earlier: tuple[str, ...] = ()
    """Versions that are read but not written."""
    description: str
    rules: Schema | None = None
    """What the schema states about several keys together."""
    is_file: bool = False
    """Whether it is a YAML file."""
    strict: bool = False
    """Whether unknown keys are rejected."""

    @property
    def head(self) -> str:
        """The key that has the version."""
        return "ringpose" if self.is_file else "schema"

    @property
    def keys(self) -> tuple[str, ...]:
        """All keys, among them that of the version."""
        return (self.head, *definition_of(self.cls).names)

    def write(self, instance: T, brief: bool = False) -> dict[str, Any]:
        """The mapping of an object; its key `software`, if it has one, names this version unless it was read."""
        return self._with_head(definition_of(self.cls).write(instance, brief))

    def values(self, instance: T) -> dict[str, Any]:
        """As `write`, with arrays instead of lists."""
        return self._with_head(definition_of(self.cls).values(instance))

    def _with_head(self, record: dict[str, Any]) -> dict[str, Any]:
        if record.get("software", "") is None:
            record["software"] = software()
        return {self.head: self.version, **record} if self.version else record

    def read(self, record: Mapping[str, Any], location: str) -> T:
        """The object in a record; `location` is used in messages."""
        definition, fields = definition_of(self.cls), Fields(location, record)
        if self.strict:
            fields.reject_unknown(self.keys)
            fields.values = {key: value for key, value in record.items() if key != self.head}
        if self.version and self.is_file:
            Fields(location, record).choice(self.head, (self.version, *self.earlier))
        elif self.version and self.kind is not None:
            fields.schema((self.version, *self.earlier), self.kind)
        return definition.read(fields, self.context)

    @property
    def context(self) -> Context:
        """What its parts are read with."""
        return Context("" if self.kind is None else f"{self.kind.remedy} unchanged", self.strict)

    def schema(self) -> Schema:
        """JSON Schema (draft 2020-12)."""
        name = self.version or self.cls.__name__
        described = json_schema((self.cls,), name, self.description) | (self.rules or {})
        if self.version:
            required = [self.head, *described["required"]]
            described |= {
                "required": required,
                "properties": {self.head: {"const": self.version}, **described["properties"]},
            }
        return described


def json_schema(classes: tuple[type, ...], name: str, description: str) -> Schema:
    """JSON Schema (draft 2020-12) of objects of one of some data classes."""
    definitions: Schema = {}
    described = [definition_of(cls).schema(definitions) for cls in classes]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:ringpose:{name.removeprefix('ringpose/').replace('/', ':').lower()}",
        "title": name,
        "description": description,
        **(described[0] if len(described) == 1 else {"anyOf": described}),
        "$defs": definitions,
    }
