"""Rigs that a script drives instead of a person."""

import pytest

from twin.play.session import End, Pace, Session


class AtOnce(Pace):
    """No clock at all: simulated as fast as it can."""

    def early(self, time):
        return 0.0


@pytest.fixture(scope="session")
def driven():
    """Drives a scenario by events at the numbers of turns, and returns the session."""

    def drive(scenario, script, last, **more):
        turn = 0

        def inbox(_):
            nonlocal turn
            turn += 1
            return (*script.get(turn - 1, ()), *([End()] if turn > last else []))

        session = Session(scenario, inbox=inbox, pace=AtOnce(), **more)
        session.run()
        return session

    return drive
