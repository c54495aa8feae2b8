"""Streams of records of moving rings."""

from moving_records import moving, records

__all__ = ["moving", "records"]
