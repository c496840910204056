"""Reads MCAP files from the front to the back; the only place that knows the `mcap` package (extra `record`).

Never by the index at the end: a program that was killed wrote none. What follows a damaged place is not read, and
`damage` says so. Every length is bounded, so that a hostile file takes no more memory than an honest one.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from base_station.errors import StationError

MOST_RECORD_BYTES = 256 << 20
MOST_CHANNELS = 1000
UNFINISHED_BYTES = (1 << 64) - 1
"""The length that a chunk has until its end is written."""
CUT_SHORT = "it is cut short, as when the program was killed"


@dataclass(frozen=True)
class Message:
    """One message. `log_ns`: when it was logged, nanoseconds since 1970."""

    topic: str
    log_ns: int
    data: bytes


@dataclass(frozen=True)
class Metadata:
    """A record of texts."""

    name: str
    fields: dict[str, str]


class McapFile:
    """What a file holds, in its order. Raises StationError when it cannot be opened or is no MCAP file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damage = ""
        """Why the file could not be read to its end; known after that much was read."""
        self._library = _mcap()
        if path.is_dir():
            raise StationError(f"{path} is a folder: name a FILE.mcap.", usage=True)
        try:
            with path.open("rb") as file:
                magic = file.read(8)
        except OSError as error:
            raise StationError(f"{path} cannot be read ({error.strerror}).", usage=True) from error
        if magic != b"\x89MCAP0\r\n":
            raise StationError(f"{path} is no MCAP file.", usage=True)

    def __iter__(self) -> Iterator[Message | Metadata]:
        self.damage = ""
        with self.path.open("rb") as file:
            yield from self._read(file)

    def _read(self, file: IO[bytes]) -> Iterator[Message | Metadata]:
        channels: dict[int, str] = {}
        records = self._library.records_of(file)
        while True:
            try:
                record = next(records, None)
                entry = None if record is None else self._library.entry_of(record, channels)
            except self._library.Damage as error:
                self.damage = str(error)
                return
            if record is None:
                return
            if entry is not None:
                yield entry


class _Library:
    """What is used of the package, with its errors turned into one."""

    class Damage(Exception):
        """The text says what is damaged."""

    def __init__(self, mcap: Any, records: Any, zstandard: Any, reader: Any) -> None:
        self._mcap, self._records, self._zstandard, self._reader = mcap, records, zstandard, reader

    def records_of(self, file: IO[bytes]) -> Iterator[Any]:
        """All records, those in chunks too."""
        stream = self._reader.StreamReader(file, emit_chunks=True, record_size_limit=MOST_RECORD_BYTES)
        try:
            for record in stream.records:
                if isinstance(record, self._records.Chunk):
                    self._check_size(record)
                    yield from self._reader.breakup_chunk(record, validate_crc=True)
                else:
                    yield record
        except (self._mcap.EndOfFile, struct.error) as error:
            raise self.Damage(CUT_SHORT) from error
        except self.Damage:
            raise
        except self._mcap.RecordLengthLimitExceeded as error:
            begun = str(UNFINISHED_BYTES) in str(error)
            raise self.Damage(CUT_SHORT if begun else f"it is damaged ({error})") from error
        except Exception as error:  # the package raises many unrelated types on garbage
            raise self.Damage(f"it is damaged ({type(error).__name__}: {str(error)[:100]})") from error

    def entry_of(self, record: Any, channels: dict[int, str]) -> Message | Metadata | None:
        """Of the records those that matter; learns the channels."""
        if isinstance(record, self._records.Channel):
            if len(channels) >= MOST_CHANNELS:
                raise self.Damage("it has too many channels")
            channels[record.id] = record.topic
        elif isinstance(record, self._records.Message):
            if record.channel_id not in channels:
                raise self.Damage("a message belongs to no channel")
            return Message(channels[record.channel_id], record.log_time, record.data)
        elif isinstance(record, self._records.Metadata):
            return Metadata(record.name, record.metadata)
        return None

    def _check_size(self, chunk: Any) -> None:
        sizes = [chunk.uncompressed_size]
        if chunk.compression == "zstd":
            told = self._zstandard.get_frame_parameters(chunk.data).content_size
            sizes += [told] if told != self._zstandard.CONTENTSIZE_UNKNOWN else []
        if max(sizes) > MOST_RECORD_BYTES:
            raise self.Damage(f"it has a chunk of {max(sizes) >> 20} MiB")


def _mcap() -> _Library:
    try:
        import zstandard
        from mcap import exceptions, records, stream_reader
    except ImportError:
        raise StationError("Recordings need the mcap package: pip install 'zservo[record]'.", usage=True) from None
    return _Library(exceptions, records, zstandard, stream_reader)
