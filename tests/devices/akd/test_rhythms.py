"""`twin.devices.akd.rhythms`: Pauses that were left out on purpose are found, and no others."""

from array import array

import pytest

from twin.devices.akd.observed import BUS, Gap, Stream, StreamKey
from twin.devices.akd.rhythms import find_rhythms, without_missing_sync

SYNC, PDO, HEARTBEAT = StreamKey(BUS, "SYNC"), StreamKey(5, "TPDO1"), StreamKey(5, "heartbeat")


def stream(times):
    return Stream(array("d", times), array("L", range(1, len(times) + 1)))


def rhythms(times, duration):
    return dict(find_rhythms({PDO: stream(times)}, duration))


def test_frames_left_out_of_a_regular_stream_are_its_gap():
    times = [0.01 * k for k in range(60) if not 20 < k < 24]
    found = rhythms(times, 0.6)[PDO]
    assert found.usual == pytest.approx(0.01)
    assert found.worst == pytest.approx(0.04)
    assert found.gaps == [Gap(0.2, 0.24, 21)]


def test_a_stream_that_ends_before_the_trace_has_a_gap_without_end():
    times = [0.01 * k for k in range(60)]
    assert rhythms(times, 0.6)[PDO].gaps == []
    assert rhythms(times, 0.7)[PDO].gaps == [Gap(times[-1], None, 60)]


def test_few_frames_and_irregular_ones_have_no_rhythm():
    assert not rhythms([0.01 * k for k in range(9)], 0.1)
    assert not rhythms([0.01 * k * k for k in range(60)], 36.0)


def test_a_gap_of_pdos_during_one_of_sync_is_none_of_their_own():
    missing, own, ended = Gap(0.2, 0.3, 20), Gap(0.5, 0.6, 50), Gap(0.9, None, 90)
    during = Gap(0.21, 0.31, 21)
    gaps = [during, own, ended]
    assert without_missing_sync(PDO, gaps, [missing]) == [own, ended]
    assert without_missing_sync(HEARTBEAT, gaps, [missing]) == gaps


def test_sync_comes_first():
    regular = stream([0.01 * k for k in range(20)])
    assert [key for key, _ in find_rhythms({PDO: regular, SYNC: regular}, 0.2)] == [SYNC, PDO]
