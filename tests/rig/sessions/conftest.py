"""Sessions of the rig in memory."""

import pytest

from rig.sessions import Session, parse_plan
from tests.rig.sessions.fake_rig import config


@pytest.fixture
def new_session(tmp_path):
    """Makes a session of a plan; closed at the end."""
    made = []

    def make(data, settings=None):
        made.append(Session.create(tmp_path / f"session{len(made)}", parse_plan(data), settings or config()))
        return made[-1]

    yield make
    for session in made:
        session.close()
