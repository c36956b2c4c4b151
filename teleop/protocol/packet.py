"""The wire format: packets to bytes and back, and the replay judge.

A datagram is, in network byte order,

    magic 2 | version 1 | kind 1 | length of the body 2 | body | padding | CRC-32 4

The body is one msgpack array `[session, seq, sent_ns, echo, payload, E_in]`; the padding is zero bytes, so
that a scene's packets have the size it names; the CRC (zlib's) covers all before it. It guards against
accident, not malice: off loopback the link has to be encrypted. Nothing a peer sends can raise: what is
wrong with a datagram is a value, a `Rejection`, for the caller to count.

A DATA packet's numbers are the messages of each axis in turn (`Layout`), and behind them the integrals of waves. An end
that couples its axes has one total (`teleop.kind`) for all of them, see `teleop.law.offers`: it is sent once, with the
first axis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import IntEnum, StrEnum
from functools import partial
from itertools import chain
from math import isfinite
from operator import itemgetter
from struct import Struct
from typing import Any, Literal, NamedTuple
from zlib import crc32

from msgpack import Packer, unpackb

from teleop.errors import Refused, WrongNumber, whole_number
from teleop.kind import totals
from teleop.scene.scene import CHECKSUM, FLOAT, HEAD, LEAST, MOST_DATA, least_size

VERSION = 4
MOST_CONTROL = 8192
MOST_SENTENCE = 1000  # characters of a REFUSE, BYE or RENEW
MOST_SEQ = 2**32 - 1
_MOST_NS = 2**63 - 1
_LEAST_NS = -_MOST_NS - 1  # msgpack has none that is less
_MAGIC = b"BT"  # "B" cannot begin a DTLS record (RFC 7983), so the two can share a port
_pack = Packer().pack
_unpack = partial(unpackb, use_list=False, strict_map_key=True, max_bin_len=0, max_ext_len=0,
                  max_array_len=MOST_DATA // FLOAT, max_map_len=MOST_CONTROL // 2, max_str_len=MOST_CONTROL)


class Kind(IntEnum):
    """Kind of a packet, which fixes its payload."""

    FORTH = 0  # the law's message, master to slave: a flat tuple of finite floats
    BACK = 1  # slave to master, so that a packet thrown back at its sender is of no use
    HELLO = 2  # master to slave: the manifest
    WELCOME = 3  # slave to master: the manifest
    REFUSE = 4  # a sentence
    START = 5  # the time of tick 0, ns
    BYE = 6  # a sentence
    RENEW = 7  # slave to master: the session is over, and why; begin another


class Code(IntEnum):
    """Code of the reason in a RENEW or BYE, in the place of `seq`. An end decides by it, never by the sentence."""

    NONE = 0  # a reason that the sentence alone says
    CLUTCH = 1  # a person holds the clutch open
    TURN = 2  # a person has ordered another law
    FINISHED = 3  # the run is at its end, which is no reason for the other end to stop

    @property
    def sentence(self) -> str:
        """Sentence that stands beside it."""
        return _SENTENCES[self]


_SENTENCES = {Code.NONE: "", Code.CLUTCH: "the clutch is open", Code.TURN: "a turn", Code.FINISHED: "finished"}
_UNCODED = {sentence: code for code, sentence in _SENTENCES.items()}


class Rejection(StrEnum):
    """Why a datagram was not accepted; in the order in which it is looked for."""

    OVERSIZE = "oversize"
    TRUNCATED = "truncated"
    MAGIC = "magic"
    VERSION = "version"
    CHECKSUM = "checksum"
    MALFORMED = "malformed"
    NON_FINITE = "non-finite"


class Echo(NamedTuple):
    """The newest send time seen from the peer, and how long ago it came, both in ns.

    `sent_ns` is on the peer's clock, `held_ns` on the sender's: round trip = now - sent_ns - held_ns.
    """

    sent_ns: int
    held_ns: int


Payload = tuple[float, ...] | dict[str, str] | str | int


class Packet(NamedTuple):
    """Packet, as sent and as received. Times in ns of the sender's clock, energy in J."""

    kind: Kind
    session: int  # 0 .. 2**64 - 1
    seq: int  # 0 .. 2**32 - 1; for DATA the tick it was sent at, modulo 2**32: see `unwrapped`; or a `Code`
    sent_ns: int
    echo: Echo | None  # None: nothing heard yet
    payload: Payload  # of the type that the kind says
    E_in: float | None = None  # the sender's cumulative energy; None: the scene has no ledger


DATA = frozenset((Kind.FORTH, Kind.BACK))
"""The kinds that carry the law's messages."""

_KINDS, _CODES = tuple(Kind), frozenset(Code)
_LAST_DATA = int(Kind.BACK)
_NUMBERS = frozenset((float,))
_TIMES = (int, int)
_CHECK = Struct("!I")
_HEAD = HEAD.size
_NOTHING = type(None)
_FIELDS = frozenset((int, int, int, echo, tuple, stamp) for echo in (tuple, _NOTHING) for stamp in (float, _NOTHING))
"""The types of the fields of a DATA packet."""
_new: Any = tuple.__new__  # twice as fast as the class


def encode(packet: Packet, size: int | None = None) -> bytes:
    """The datagram of `packet`, padded to `size` bytes (None: no padding).

    `decode` gives the same packet back to the bit. A sentence is sent as `one_line` makes it. Raises `Refused` if the
    packet does not fit or a manifest has unprintable text. What a DATA packet carries is not checked here: the peer
    rejects what is not finite floats.
    """
    kind, payload = packet.kind, packet.payload
    if isinstance(payload, str):
        packet = packet._replace(payload=one_line(payload))
    elif isinstance(payload, dict) and not _is_manifest(payload):
        raise Refused(f"knobs are sent as printable text; write them without control characters: {payload!r}")
    return framed(kind, packet[1:], size)


def framed(kind: Kind, fields: tuple[Any, ...], size: int | None) -> bytes:
    """The datagram of a packet of which nothing is checked but its length; `fields`: all but its kind."""
    body = _pack(fields)
    control = kind > _LAST_DATA
    most = size or (MOST_CONTROL if control else MOST_DATA)
    if len(body) + LEAST > most:
        cure = "shorten the scene's knobs" if control else "send fewer numbers or write a larger packet_size"
        raise Refused(f"a {Kind(kind).name} packet of {len(body) + LEAST} bytes is above {most}; {cure}")
    data: bytes = HEAD.pack(_MAGIC, VERSION, kind, len(body)) + body
    if size:
        data = data.ljust(size - CHECKSUM, b"\0")
    return data + _CHECK.pack(crc32(data))


def decode(data: bytes, width: int) -> Packet | Rejection:
    """The packet in a datagram, or why there is none. Never raises, whatever the bytes.

    `width` is how many numbers a DATA packet carries, exactly. Session and replay are not judged here.
    """
    size = len(data)
    if not LEAST <= size <= MOST_CONTROL:
        return Rejection.TRUNCATED if size < LEAST else Rejection.OVERSIZE
    magic, version, kind, length = HEAD.unpack_from(data)
    if magic != _MAGIC:
        return Rejection.MAGIC
    if version != VERSION:
        return Rejection.VERSION
    if kind <= _LAST_DATA and size > MOST_DATA:
        return Rejection.OVERSIZE
    if length + LEAST > size:
        return Rejection.TRUNCATED
    if crc32(data[:-CHECKSUM]) != _CHECK.unpack_from(data, size - CHECKSUM)[0]:
        return Rejection.CHECKSUM
    end = _HEAD + length
    if kind >= len(_KINDS) or data[end:-CHECKSUM].strip(b"\0"):
        return Rejection.MALFORMED
    try:
        fields = _unpack(data[_HEAD:end])
    except Exception:  # bytes of an unknown sender: whatever msgpack raises over them, they are not a packet
        return Rejection.MALFORMED
    return _checked(_KINDS[kind], fields, width)


def code_of(packet: Packet) -> Code:
    """The code in a RENEW or BYE, NONE if it is unknown here.

    Ends sent the sentence alone before there were codes: for this release that counts too.
    """
    if packet.seq == 0 and isinstance(packet.payload, str):
        return _UNCODED.get(packet.payload, Code.NONE)
    return Code(packet.seq) if packet.seq in _CODES else Code.NONE


def _checked(kind: Kind, fields: Any, width: int) -> Packet | Rejection:
    """The packet of these fields, if each is exactly of its type and within its range."""
    if type(fields) is not tuple or len(fields) != 6:
        return Rejection.MALFORMED
    session, seq, sent_ns, echo, payload, E_in = fields
    if (kind <= _LAST_DATA and tuple(map(type, fields)) in _FIELDS and session >= 0 and 0 <= seq <= MOST_SEQ
            and sent_ns <= _MOST_NS and len(payload) == width and _NUMBERS.issuperset(map(type, payload))
            and (echo is None
                 or (tuple(map(type, echo)) == _TIMES and echo[0] <= _MOST_NS and 0 <= echo[1] <= _MOST_NS))
            and isfinite(sum(payload)) and (E_in is None or isfinite(E_in))):
        # Nearly always. What is not so is looked at field by field: finite numbers may have a sum that is not.
        packet: Packet = _new(
            Packet, (kind, session, seq, sent_ns, None if echo is None else _new(Echo, echo), payload, E_in))
        return packet
    if not (
        # `type(..) is` and not isinstance: a bool is an int, and msgpack carries both.
        type(session) is int and session >= 0
        and type(seq) is int and 0 <= seq <= MOST_SEQ
        and _is_time(sent_ns)
        and (echo is None or _is_echo(echo))
        and (E_in is None or type(E_in) is float)
        and (_is_message(payload, width) if kind <= _LAST_DATA else _is_control(kind, payload))
    ):
        return Rejection.MALFORMED
    if not ((kind > _LAST_DATA or all(map(isfinite, payload))) and (E_in is None or isfinite(E_in))):
        return Rejection.NON_FINITE
    return Packet(kind, session, seq, sent_ns, None if echo is None else Echo(*echo), payload, E_in)


def _is_time(value: Any) -> bool:
    return type(value) is int and _LEAST_NS <= value <= _MOST_NS  # msgpack goes up to uint64


def _is_echo(value: Any) -> bool:
    return type(value) is tuple and len(value) == 2 and all(map(_is_time, value)) and value[1] >= 0


def _is_message(payload: Any, width: int) -> bool:
    return type(payload) is tuple and len(payload) == width and {float}.issuperset(map(type, payload))


def _is_control(kind: Kind, payload: Any) -> bool:
    if kind is Kind.START:
        return _is_time(payload)
    if kind in (Kind.REFUSE, Kind.BYE, Kind.RENEW):
        return type(payload) is str and len(payload) <= MOST_SENTENCE and payload.isprintable()
    return type(payload) is dict and _is_manifest(payload)


def _is_manifest(entries: Mapping[str, str]) -> bool:
    # A peer's texts are shown to people: an escape sequence in one would reach their terminal.
    texts = [*entries, *entries.values()]
    return {str}.issuperset(map(type, texts)) and "".join(texts).isprintable()


def unwrapped(seq: int, near: int) -> int:
    """The packet number that is `seq` modulo 2**32 and nearest to `near`."""
    return near + (seq - near + 2**31) % 2**32 - 2**31


def one_line(text: str) -> str:
    """`text` as a sentence that can be sent: on one line, printable, at most 1000 characters.

    >>> one_line("disk full:\\n  stopped\\x1b[2J")
    'disk full: stopped?[2J'
    """
    line = " ".join(text.split())[:MOST_SENTENCE]
    return line if line.isprintable() else "".join(c if c.isprintable() else "?" for c in line)


def check_size(size: int, width: int, *, energy: bool = True) -> int:
    """`size` if every DATA packet of `width` numbers can be padded to it, otherwise `Refused`."""
    least = least_size(width, energy=energy)
    try:
        return whole_number("packet_size", size, low=least, high=MOST_DATA)
    except WrongNumber as wrong:
        raise wrong.with_note(f"{width} numbers need {least} bytes") from None


class Window:
    """Window of the sequence numbers of one session that have come, so that each is taken once.

    Remembers the last `size` numbers in a ring (the window of RFC 4303, 3.4.3). A number more than `ahead` beyond
    both the newest and the receiver's own tick is not believed: taken at its word, one forged 2**32 - 1
    would make every honest packet old. No single one can, with `ahead` + the delay in ticks within `size`.
    """

    __slots__ = ("_ahead", "_seen", "_size", "newest")

    def __init__(self, ahead: int = 1024, size: int = 4096) -> None:
        if not 1 <= ahead <= size:
            raise Refused(f"ahead must be from 1 to size={size}, not {ahead}; write ahead={size // 4}")
        self.newest = -1  # the greatest number taken
        self._ahead, self._size = ahead, size
        self._seen = bytearray(size)  # at n % size: has n come, of the last `size` numbers

    def judge(self, seq: int, tick: int = 0) -> Literal["new", "duplicate", "old", "ahead"]:
        """Take `seq` down if it is "new", and say so; otherwise why it is not to be used.

        `tick` is the receiver's own tick: packets are numbered by ticks, so that after a long silence the
        honest ones are as far ahead of the newest as the clock is.
        """
        step = seq - self.newest
        if step == 1:  # nearly always
            self._seen[seq % self._size] = 1
            self.newest = seq
            return "new"
        if step > 0:
            if step > self._ahead and seq > tick + self._ahead:
                return "ahead"
            size = self._size
            if step >= size:
                self._seen = bytearray(size)
            else:
                first, last = (self.newest + 1) % size, seq % size  # what was skipped has not come, as far as `last`
                if first <= last:
                    self._seen[first:last] = bytes(last - first)
                else:
                    self._seen[first:], self._seen[:last] = bytes(size - first), bytes(last)
            self._seen[seq % size] = 1
            self.newest = seq
            return "new"
        if -step >= self._size or seq < 0:
            return "old"
        at = seq % self._size
        if self._seen[at]:
            return "duplicate"
        self._seen[at] = 1
        return "new"


def peek(data: bytes) -> tuple[Kind, int] | tuple[None, int]:
    """A datagram's kind and number, for a relay it is not for; (None, -1) if it is no packet. Never raises."""
    if not LEAST <= len(data) <= MOST_CONTROL:
        return None, -1
    magic, version, kind, length = HEAD.unpack_from(data)
    if magic != _MAGIC or version != VERSION or kind >= len(_KINDS):
        return None, -1
    if crc32(data[:-CHECKSUM]) != int.from_bytes(data[-CHECKSUM:], "big"):
        return None, -1
    try:
        seq = unpackb(data[HEAD.size : HEAD.size + length], use_list=False)[1]
    except Exception:  # bytes of an unknown sender
        return None, -1
    return (_KINDS[kind], seq) if type(seq) is int and 0 <= seq <= MOST_SEQ else (None, -1)


class Layout:
    """Messages of type `kind`, one for each axis, as a flat tuple. `couples`: their sender couples its axes."""

    __slots__ = ("_axes", "_fields", "_kind", "_of_axis", "_sent", "width")

    def __init__(self, kind: Any, axes: int, *, couples: bool) -> None:
        once = totals(kind) if couples else ()
        self._kind, self._axes, self._fields = kind, axes, len(kind._fields)
        each = [i for i, field in enumerate(kind._fields) if field not in once]
        self.width = self._fields + (axes - 1) * len(each)  # numbers in a packet
        first = list(range(self._fields))
        sent, places = first.copy(), [first]  # which numbers of all messages are sent; where those of an axis stand
        for i in range(1, axes):
            sent += [i * self._fields + field for field in each]
            places.append([self._fields + (i - 1) * len(each) + each.index(field) if field in each else field
                           for field in first])
        self._sent = None if len(sent) == axes * self._fields else _picker(sent)
        self._of_axis = [_picker(each_axis) for each_axis in places]

    def flat(self, messages: tuple[Any, ...]) -> tuple[float, ...]:
        """The numbers of the messages of all axes, each a float: a law may give an int, or a number of numpy's."""
        if len(messages) == 1:
            return tuple(map(float, messages[0]))
        numbers = tuple(map(float, chain.from_iterable(messages)))
        return numbers if self._sent is None else self._sent(numbers)

    def messages(self, numbers: tuple[float, ...]) -> tuple[Any, ...]:
        """The messages of all axes; what stands behind them in `numbers` is not theirs."""
        if self._axes == 1:
            return (_new(self._kind, numbers[:self._fields]),)
        return tuple([_new(self._kind, of_axis(numbers)) for of_axis in self._of_axis])


def _picker(places: list[int]) -> Callable[[tuple[float, ...]], tuple[float, ...]]:
    """A function that gives the numbers at these places."""
    if len(places) == 1:
        return itemgetter(slice(places[0], places[0] + 1))
    return itemgetter(*places)
