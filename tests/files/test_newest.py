"""Output for slow readers."""

import json
import os
import select
import sys

from ringpose.files.records.newest import NewestWriter


def test_a_reader_that_was_slow_gets_the_newest_record_and_the_number_of_those_skipped(monkeypatch):
    reading, writing = os.pipe()
    monkeypatch.setattr(sys, "stdout", os.fdopen(writing, "w"))

    def waiting():
        select.select([reading], [], [])
        return json.loads(os.read(reading, 1 << 16))

    with sys.stdout, NewestWriter() as writer:
        writer.write({"number": 0})
        select.select([reading], [], [])  # it is in the pipe
        for number in range(1, 100):
            writer.write({"number": number})
        records = [waiting(), waiting()]
    os.close(reading)

    assert records == [{"number": 0, "lines_skipped": 0}, {"number": 99, "lines_skipped": 98}]
