"""The command line as a whole: how it begins, what it refuses, what it says meanwhile."""

from twin.cli import output


def test_list_shows_every_scenario_with_its_title(ballplate):
    code, out, _ = ballplate("list")
    assert code == 0
    assert "circle" in out
    assert "Hold on the centre" in out


def test_without_arguments_it_says_how_to_begin(ballplate):
    code, out, _ = ballplate()
    assert code == 0
    assert "ballplate run circle" in out


def test_progress_says_share_rate_and_time_left(monkeypatch):
    now = iter((100.0, 102.0, 104.0))
    monkeypatch.setattr(output, "monotonic", lambda: next(now))
    counted = output.Meter(120, "runs")
    assert counted.text(20, "0 failed") == "20 of 120 runs, 0 failed"  # done before
    assert counted.text(30, "1 failed") == (
        "30 of 120 runs, 5 per second, about 18 s left, 1 failed"
    )
    assert counted.text(120) == "120 of 120 runs, 25 per second"
    now = iter((0.0, 3.0))
    share = output.Meter(2.0)
    assert [share.text(0.0), share.text(0.5)] == ["0%", "25%, about 9 s left"]
