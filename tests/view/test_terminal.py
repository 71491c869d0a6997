import numpy as np
import pytest
from click.testing import CliRunner

from twin.cli.runs import run as run_command
from twin.run.finished import run
from twin.view.terminal import Summary


def test_the_summary_says_where_the_run_is(scenario):
    chosen = scenario("duration=4")
    done = run(scenario("duration=2"))
    names = {"state": "true", "estimate": "estimated"}
    rows = {"time": done.record.time, "supervisor": done.record["supervisor"][:, 0, 0]}
    for channel, kind in names.items():
        for i, part in enumerate(
            ("x", "x_rate", "phi", "phi_rate", "y", "y_rate", "theta", "theta_rate")
        ):
            rows[f"{kind}_{part}"] = done.record[channel][:, 0, i]
    summary = Summary(chosen)
    assert summary.fields() == {}
    for begin in range(0, 1000, 130):
        summary.take({name: column[begin : begin + 130] for name, column in rows.items()})
    told = summary.fields()
    distance = 1000 * np.hypot(*(done.motion.reference - done.motion.ball).T)
    assert told["progress"] == "2.0 of 4 s (50%)"
    assert told["error"].startswith(f"{distance[-1]:.1f} mm")
    assert f"{np.sqrt((distance[-500:] ** 2).mean()):.1f} mm RMS" in told["error"]
    assert f"largest {distance.max():.1f} mm" in told["error"]
    assert told["state"] == "running"


@pytest.mark.long
def test_without_a_terminal_the_summary_is_plain_lines(quick, capfd):
    done = CliRunner().invoke(run_command, [*quick, "--watch"])
    assert done.exit_code == 0, done.output
    (line,) = capfd.readouterr().err.strip().splitlines()
    assert line.startswith("0.4 of 0.4 s (100%), error ")
    assert "\x1b" not in line
