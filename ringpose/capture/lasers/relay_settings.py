"""How a relay board is spoken to and guarded: what the URI says, handed to the guard as one line of JSON."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

from ringpose.wire.ascii_relays import AsciiCodec
from ringpose.wire.lcus import LcusCodec
from ringpose.wire.modbus import ModbusCodec
from ringpose.wire.numato import NumatoCodec
from ringpose.wire.relay_codec import RelayCodec

CODECS = {"lcus": LcusCodec, "numato": NumatoCodec, "modbus": ModbusCodec, "ascii": AsciiCodec}


@dataclass(frozen=True, slots=True, kw_only=True)
class RelaySettings:
    """One board: its port, its bytes, which of its relays (from 0) feed the lasers, and when the guard steps in."""

    scheme: str
    port: str
    relays: tuple[int, ...]
    baud: int = 9600
    codec_parameters: Mapping[str, str | int] = field(default_factory=dict)
    read_back: str = "yes"
    """`yes`; `no`; or `try`: unless the board is silent when it is first asked."""
    pulse_s: float | None = None
    """Light by the board's own timed pulse of this length."""
    repeat_s: float | None = None
    """Say again what is on, for a board that switches off when it hears nothing."""
    opening_s: float = 0.0
    """Wait after opening: an Arduino starts anew."""
    heartbeat_s: float = 1.0
    """Off if nothing was heard for this long while a laser is on."""
    longest_on_s: float = 5.0
    """Off if a laser is on for longer than this."""
    interlock: str = ""
    """The input that must be closed: `cts`, `dsr`, or none."""

    @property
    def codec(self) -> RelayCodec:
        """The bytes of the board."""
        codec: RelayCodec = CODECS[self.scheme](**self.codec_parameters)
        return codec

    @property
    def on_limit_s(self) -> float:
        """How long a laser stays on at most: the guard's limit, or the board's own pulse if nothing prolongs it."""
        pulse_ends = self.pulse_s is not None and self.repeat_s is None
        return min(self.longest_on_s, self.pulse_s) if pulse_ends and self.pulse_s else self.longest_on_s

    def line(self) -> str:
        """All of it in one line."""
        return json.dumps(asdict(self))


def settings_of_line(line: str) -> RelaySettings:
    """What `line` wrote."""
    values = json.loads(line)
    return RelaySettings(**{**values, "relays": tuple(values["relays"])})
