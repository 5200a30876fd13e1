"""What a parser has seen, for whatever protocol."""

from dataclasses import dataclass, field


@dataclass(slots=True)
class ParserCounters:
    """What the parser has seen; only grows.

    Attributes:
        records: good data records.
        responses: good answers and other messages that are not data.
        bad_records: records that began well and turned out malformed.
        skipped_bytes: bytes that belong to nothing good.
        bad_by_station: malformed records by the station their head named.
    """

    records: int = 0
    responses: int = 0
    bad_records: int = 0
    skipped_bytes: int = 0
    bad_by_station: dict[int, int] = field(default_factory=dict)
