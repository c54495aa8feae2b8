"""The keys of records: what an annotation states about a key beside its type.

A data class is the one definition of a record: reader, writer, JSON Schema and the table of its keys in the manual are
derived from it (`ringpose.files.records.codec`). A field is a key if it is annotated with a `Key`, and so is a property
whose result is.

    radius_inner_m: Annotated[float, Key("Radius of the inner edge; null if it was not observed.", null=nan)]
"""

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from enum import Enum, auto
from math import inf
from typing import Annotated, Any, get_args, get_origin

from ringpose.types.plausible import Range


class Form(Enum):
    """Conditions on the numbers of an array, or on texts, that its shape does not state."""

    UNIT_VECTOR = auto()
    QUATERNION = auto()
    DIRECTION = auto()
    """A vector that is not of length 0."""
    DIRECTIONS = auto()
    """Vectors in the plane, none of them of length 0."""
    ORTHONORMAL = auto()
    COVARIANCE = auto()
    """Symmetric and positive semidefinite; with `gaps`, null in the rows and columns of what is not determined."""
    COVARIANCES = auto()
    """2 x 2 covariances along the last two axes."""
    SIGMAS = auto()
    UPPER_TRAPEZOIDAL = auto()
    POINTS = auto()
    """Both coordinates of a point are null, or none."""
    STAMP = auto()
    """Seconds, at most those of the year 2100."""
    BOUNDED_LENGTH = auto()
    """A vector whose length, not its elements, is in the plausible range."""
    DISTINCT = auto()
    """Names, of which none is empty and none occurs twice."""
    FILE_NAME = auto()
    """A name that is a valid file name."""


class Presence(Enum):
    """When a key is written."""

    ALWAYS = auto()
    NOT_BRIEF = auto()
    """It is left out of a brief record."""
    IF_KNOWN = auto()
    """It is left out if it is None, empty, or the default of its field."""


REQUIRED: Any = object()
"""Stands for no value: null, or a missing key, is an error."""


@dataclass(frozen=True, slots=True, repr=False)
class Key:
    """One key of a record."""

    description: str = ""
    """Sentences for the schema and the manual; names of keys, values and options in backticks."""
    _: KW_ONLY
    name: str = ""
    """Name in the record if it is not that of the field."""
    after: str = ""
    """Of a property: the key that it follows; empty: it comes first."""
    is_read: bool = False
    """Whether a property is read, too: it is an argument of `from_record` of its class, which makes the object."""
    null: Any = REQUIRED
    """What null stands for, and a missing key. An array is null if any of its elements is not finite."""
    needed: bool = False
    """Whether the key must be there although the field has a default."""
    added: bool = False
    """Whether it was added within the version, so that older records lack it."""
    presence: Presence = Presence.ALWAYS
    earlier: str = ""
    """Its name in the version before."""
    least: float | int = -inf
    most: float | int = inf
    plausible: Range | None = None
    """Range of the quantity."""
    positive: bool = False
    """Whether a number, or each of an array, must be greater than 0."""
    pattern: str = ""
    """Regular expression of a text in the schema; readers accept any text."""
    blank: bool = False
    """A text may be empty."""
    gaps: bool = False
    """Elements of an array may be null, which is NaN."""
    null_points: bool = False
    """A point of which nothing is known is written as null, not as a list of nulls."""
    form: Form | None = None
    remedy: str = ""
    """What to do where a vector does not have its length."""
    words: Mapping[Any, str] = field(default_factory=dict)
    """Words that stand for some values, or for all of a class without keys."""
    constant: tuple[str, ...] | None = None
    """The only value that a property has."""
    tag: str = ""
    """Of several data classes: the key whose word, or presence, shows which one a mapping is."""
    grows: bool = False
    """Later versions may add words: an entry with an unknown one is ignored."""

    def __hash__(self) -> int:
        return id(self)


def key_of(hint: Any) -> Key | None:
    """The key in an annotation; None if it has none."""
    arguments = get_args(hint) if get_origin(hint) is Annotated else ()
    return next((each for each in arguments if isinstance(each, Key)), None)
