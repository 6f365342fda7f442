"""The protobuf wire format, as far as a model file needs it: strict, bounded, without copies.

Only what a schema names is taken; what stands twice where it may stand once is refused, since
readers disagree on what that means.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_LONGEST_VARINT = 10  # bytes, for 64 bits
#: Values of one file: a file of 64 MiB could hold 30 million, which take minutes to walk through.
MAX_VALUES = 200_000


class WireError(ValueError):
    """Bytes that are no message of the schema: the message says what is wrong."""


@dataclass(frozen=True)
class Field:
    """One field of a message.

    Attributes
    ----------
    name
        What the decoded message calls it.
    kind
        ``"int"`` (signed 64 bits), ``"float"``, ``"text"``, ``"bytes"``, or ``"skip"`` for bytes
        that are of no interest.
    repeated
        Whether it may stand more than once, and is a list.
    """

    name: str
    kind: str
    repeated: bool = False


class Wire:
    """Decodes the messages of one file, and counts their values, of which there is a most."""

    def __init__(self, most: int = MAX_VALUES) -> None:
        self._most = self._left = most

    def decode(self, what: str, data: memoryview, schema: Mapping[int, Field]) -> dict[str, Any]:
        """The fields of a message by name; those that are absent are absent, or empty lists.

        Parameters
        ----------
        what
            The message's name, for errors.
        data
            Its bytes.
        schema
            Its fields by number.

        Raises
        ------
        WireError
            The bytes are cut short, hold a field that the schema lacks or one of another type, or
            too many values.
        """
        found: dict[str, Any] = {field.name: [] for field in schema.values() if field.repeated}
        place = 0
        while place < len(data):
            key, place = self._varint(what, data, place)
            field = schema.get(key >> 3)
            if field is None:
                raise WireError(f"its {what} holds field {key >> 3}, which no export writes")
            values, place = self._values(f"{what}'s {field.name}", data, place, key & 7, field)
            if field.repeated:
                found[field.name] += values
            elif field.name in found:
                raise WireError(f"its {what} holds {field.name} twice")
            else:
                found[field.name] = values[0]
        return found

    def changed(
        self,
        what: str,
        data: memoryview,
        changes: Mapping[int, Callable[[memoryview], bytes | memoryview | None]],
    ) -> bytes:
        """A message as it is, but for its fields of some numbers, which are bytes.

        Parameters
        ----------
        what, data
            As `decode` takes them; a message that it has decoded.
        changes
            By number, what gives the bytes that stand in a field's place; None leaves it out.
        """
        parts: list[bytes | memoryview] = []
        place = 0
        while place < len(data):
            start = place
            key, place = self._varint(what, data, place)
            if key & 7 != _BYTES:
                place = self._varint(what, data, place)[1] if key & 7 == _VARINT else place + 4
                parts.append(data[start:place])
                continue
            length, begin = self._varint(what, data, place)
            place = begin + length
            change = changes.get(key >> 3)
            if change is None:
                parts.append(data[start:place])
            elif (value := change(data[begin:place])) is not None:
                parts.append(field_of(key >> 3, value))
        return b"".join(parts)

    def _values(
        self, what: str, data: memoryview, place: int, wire: int, field: Field
    ) -> tuple[list[Any], int]:
        if wire == _BYTES:
            length, place = self._varint(what, data, place)
            if not 0 <= length <= len(data) - place:
                raise WireError(f"its {what} is cut short")
            chunk = data[place : place + length]
            return self._of_bytes(what, chunk, field), place + length
        if wire == _VARINT and field.kind == "int":
            value, place = self._varint(what, data, place)
            return [_signed(value)], place
        if wire == _FIXED32 and field.kind == "float":
            if len(data) - place < 4:
                raise WireError(f"its {what} is cut short")
            self._count(what)
            return [struct.unpack_from("<f", data, place)[0]], place + 4
        raise WireError(f"its {what} is of the wrong type")

    def _of_bytes(self, what: str, chunk: memoryview, field: Field) -> list[Any]:
        self._count(what)
        if field.kind in ("bytes", "skip"):
            return [chunk]
        if field.kind == "text":
            try:
                return [str(chunk, "utf-8")]
            except UnicodeDecodeError:
                raise WireError(f"its {what} is not UTF-8") from None
        if not field.repeated:
            raise WireError(f"its {what} is of the wrong type")
        # numbers of a list may stand together
        if field.kind == "float":
            if len(chunk) % 4:
                raise WireError(f"its {what} is cut short")
            self._count(what, len(chunk) // 4)
            return list(struct.unpack(f"<{len(chunk) // 4}f", chunk))
        values, place = [], 0
        while place < len(chunk):
            value, place = self._varint(what, chunk, place)
            values.append(_signed(value))
        return values

    def _varint(self, what: str, data: memoryview, place: int) -> tuple[int, int]:
        self._count(what)
        value = 0
        for index, byte in enumerate(data[place : place + _LONGEST_VARINT]):
            value |= (byte & 0x7F) << (7 * index)
            if byte < 0x80:
                return value & (2**64 - 1), place + index + 1
        raise WireError(f"its {what} is cut short")

    def _count(self, what: str, values: int = 1) -> None:
        self._left -= values
        if self._left < 0:
            raise WireError(f"it holds more than {self._most} values, the last of its {what}")


def _signed(value: int) -> int:
    return value - 2**64 if value >= 2**63 else value


def field_of(number: int, value: int | bytes | memoryview) -> bytes:
    """A field of a message: a number, 0 or more, or bytes."""
    if isinstance(value, int):
        return _varint_of(number << 3 | _VARINT) + _varint_of(value)
    return _varint_of(number << 3 | _BYTES) + _varint_of(len(value)) + bytes(value)


def _varint_of(value: int) -> bytes:
    parts = []
    while value > 0x7F:
        parts.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*parts, value])
