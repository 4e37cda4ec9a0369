"""Kills sessions and takes them up again; run as a process of its own, because it forks.

Every case is a child process that runs a session on the rig in memory until SIGKILL hits it, then another that resumes.
"""

import json
import os
import random
import signal
import sys
import time
import traceback
from contextlib import contextmanager
from pathlib import Path

from rig.sessions import Runner, Session, State, parse_plan
from rig.sessions import journal as journal_module
from tests.rig.sessions.fake_rig import ENVIRONMENT, MDF, SRF, UNTOLD_MDF, config, fake_rig

CONFIG = config()
FINISHED = 3  # an exit status
PHOTOGRAPHS = {**SRF, "arm_deg": [-20, 30], "exposures_s": [0.1]}
SWEEPS = {**MDF, "laser_azimuth_deg": [45], "laser_elevations_deg": [35], "cameras": ["cam0"]}
TESTED = {**UNTOLD_MDF, "laser_azimuth_deg": [45], "laser_elevations_deg": [35], "cameras": ["cam0"]}
LONG = {**SRF, "arm_deg": [-60, -40, -20, 20, 40, 60], "exposures_s": [0.05, 0.1, 0.2]}


def in_child(act):
    """Run in a forked process; its exit status as of os.waitpid."""
    child = os.fork()
    if child == 0:
        try:
            act()
        finally:
            if sys.exc_info()[0] is not None:
                traceback.print_exc()
            os._exit(1 if sys.exc_info()[0] else 0)
    return child


def ended(child):
    status = os.waitpid(child, 0)[1]
    return os.waitstatus_to_exitcode(status)


def run(folder):
    with Session.open(folder) as session:
        Runner(session, fake_rig(CONFIG)[0]).run()


def kill_at(count):
    """Patch everything that makes something durable: the process dies just before one, which is just after the last."""
    left = [count]

    def step():
        left[0] -= 1
        if left[0] == 0:
            os.kill(os.getpid(), signal.SIGKILL)

    def deadly(function):
        def wrapped(*args, **kwargs):
            step()
            return function(*args, **kwargs)

        return wrapped

    transaction = journal_module.Journal._transaction

    @contextmanager
    def deadly_transaction(self):
        step()
        with transaction(self) as db:
            yield db
            step()

    os.fsync = deadly(os.fsync)
    Path.rename = deadly(Path.rename)
    journal_module.Journal._transaction = deadly_transaction


def check(folder):
    """None missing, none twice, none corrupt; what was done before the crash was left alone."""
    with Session.open(folder) as session:
        was_done = {step: session.journal.attempts(step) for step in session.done()}
        crashed = session.state
        if session.remaining() or crashed is not State.FINISHED:
            Runner(session, fake_rig(CONFIG)[0]).run()
        wanted = sum(len(step.cameras) for step in session.steps if not step.test)
        assert session.verify() == wanted
        assert all(record.exposure_s == record.step.exposure_s for record in session.frames())
        done = [event.step for event in session.events() if event.kind == "done"]
        assert sorted(done) == sorted(step.id for step in session.steps)
        assert all(session.journal.attempts(step) == count for step, count in was_done.items())
        names = sorted(path.name for path in folder.glob("frames/*/*"))
        assert names == sorted(record.path.name for record in session.frames())
        assert crashed in (State.IDLE, State.INTERRUPTED, State.FINISHED)


def kill_at_every_point(folder, data):
    """Number of points at which the process was killed."""
    count = 0
    while True:
        count += 1
        place = folder / f"{count}"
        Session.create(place, parse_plan(data), CONFIG).close()
        killed = ended(in_child(lambda count=count, place=place: (kill_at(count), run(place))))
        assert ended(in_child(lambda place=place: check(place))) == 0, f"after a kill at point {count}"
        if killed == 0:
            return count - 1
        assert killed == -signal.SIGKILL


def kill_again_and_again(folder, rng):
    """One session, killed at random instants until it gets through; how often it was killed."""
    Session.create(folder, parse_plan(LONG), CONFIG).close()
    kills = 0
    while True:
        child = in_child(lambda: run(folder))
        time.sleep(rng.uniform(0.0, 0.04) * (1 + kills / 10))
        os.kill(child, signal.SIGKILL)
        if ended(child) != -signal.SIGKILL:
            break
        kills += 1
        if ended(in_child(lambda: tell_state(folder))) == FINISHED:
            break
    assert ended(in_child(lambda: check(folder))) == 0
    return kills


def tell_state(folder):
    with Session.open(folder) as session:
        os._exit(FINISHED if session.state is State.FINISHED else 0)


def main(folder):
    found = {
        "photographs": kill_at_every_point(folder / "photographs", PHOTOGRAPHS),
        "place": kill_at_every_point(folder / "place", ENVIRONMENT),
        "sweeps": kill_at_every_point(folder / "sweeps", SWEEPS),
        "tested": kill_at_every_point(folder / "tested", TESTED),
        "random": sum(kill_again_and_again(folder / f"random{seed}", random.Random(seed)) for seed in range(3)),
    }
    sys.stdout.write(json.dumps(found))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
