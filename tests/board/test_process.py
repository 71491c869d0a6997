"""`twin.board.process`: programs that answer, and those that do not."""

import time

import pytest
from board_program import program

from controllers.catalog import AnswerError
from twin.base.errors import ScenarioError
from twin.board.process import BoardProcess

MEASURED = [0.25, *([0.0] * 16)]


def begin(file, limit=0.3):
    return BoardProcess(file, "board.program mine", 0.002, limit)


def test_a_program_is_asked_again_and_again_and_ends_with_its_last_user(tmp_path):
    process = begin(program(tmp_path, rate="(count, measured[0])"))
    answers = [process.ask([each, *MEASURED[1:]]) for each in range(600)]
    assert [each.rate.tolist() for each in answers] == [[k + 1, k] for k in range(600)]
    assert answers[0].instructions == 1000
    child = process._process
    assert child.poll() is None
    del process
    assert child.poll() is not None


@pytest.mark.parametrize(
    ("act", "words"),
    [
        ("rest()", "gave no answer within 0.3 s$"),
        ("say(frame(number, *answer)[:50]); rest()", "no answer within 0.3 s but 50 bytes of it$"),
        ("say(b'x = 3 mm'); rest()", "sent 'x = 3 mm', but a frame begins with 0xb5$"),
        ("say(frame(number, *answer) * 2); rest()", "sent 118 bytes more than one frame"),
        ("say(frame(number + 1, *answer)); rest()", "sent frame 3 instead of 2$"),
        ("say(frame(number, *answer[:-1])); rest()", "a frame of 104 bytes instead of 112$"),
        ("say(frame(number, *answer)[:-1] + b'?')", "a frame with the check sum 0x"),
        ("answer[1] = float('nan'); say(frame(number, *answer))", "not all numbers, at 0.25 s$"),
        ("answer[-2] = 0; say(frame(number, *answer))", r"\(valid = 0\), at 0.25 s$"),
        ("sys.exit(3)", "its process ended, exit status 3$"),
        ("sys.exit('out of\\nmemory')", "its process ended, exit status 1: out of$"),
    ],
)
def test_what_fails_is_one_line_that_names_the_program(act, words, tmp_path):
    process = begin(program(tmp_path, act=act, at=2))
    process.ask(MEASURED)
    with pytest.raises(AnswerError, match=words) as error:
        process.ask(MEASURED)
    assert str(error.value).startswith("board.program mine: ")
    assert "\n" not in str(error.value)


def test_a_second_answer_that_comes_later_is_noticed_at_the_next(tmp_path):
    act = "say(frame(number, *answer)); time.sleep(0.1); say(frame(number, *answer))"
    process = begin(program(tmp_path, act=act, at=2))
    process.ask(MEASURED)
    process.ask(MEASURED)
    time.sleep(0.3)
    with pytest.raises(AnswerError, match="sent frame 2 instead of 3"):
        process.ask(MEASURED)


@pytest.mark.parametrize(
    ("hello", "words"),
    [
        ("b''", "gave no answer within 0.4 s"),
        ("b'Hello, world'", "sent 'Hello, world', but"),
        ("frame(0, 2.0, 0.002)", "speaks version 2 of the protocol, which is 1"),
        ("frame(0, 1.0, 0.005)", r"made for a period of 0.005 s; rig.period is 0.002 s"),
        ("frame(0, 1.0, float('nan'))", "made for a period of nan s"),
        ("sys.exit(0)", "its process ended, exit status 0"),
    ],
)
def test_a_program_must_begin_with_its_version_and_period(hello, words, tmp_path, monkeypatch):
    monkeypatch.setattr("twin.board.process.START_TIMEOUT_S", 0.4)
    with pytest.raises(AnswerError, match=words):
        begin(program(tmp_path, hello=hello))


def test_a_file_that_cannot_be_run_is_named(tmp_path):
    file = program(tmp_path)
    file.chmod(0o644)
    with pytest.raises(ScenarioError, match=r"board.program mine: cannot be run: Permission"):
        begin(file)
    other = tmp_path / "no.elf"
    other.write_text("no program")
    with pytest.raises(ScenarioError, match=r"no.elf is no ELF file for an ARM processor"):
        begin(other)
