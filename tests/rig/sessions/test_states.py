"""The table of transitions, and a running session held against it under random requests."""

import threading

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from rig.errors import StateError
from rig.sessions import ACTIVE, TRANSITIONS, Action, Runner, Session, State, allowed, parse_plan
from rig.sessions.states import REQUESTS, Machine
from tests.rig.sessions.fake_rig import PLANS, config, fake_rig, is_safe

CONFIG = config()
ENDS = {State.FINISHED, State.ABORTED, State.FAILED, State.INTERRUPTED}
PATIENCE_S = 20  # of a test that waits for another thread; never used up unless it hangs


@pytest.mark.parametrize("state", State)
def test_what_the_table_does_not_list_is_refused_and_changes_nothing(state):
    for action in Action:
        machine = Machine(state)
        if (state, action) in TRANSITIONS:
            assert machine.apply(action) is TRANSITIONS[state, action]
            continue
        with pytest.raises(StateError) as caught:
            machine.apply(action)
        assert machine.state is state
        assert state in str(caught.value)
        assert all(request in str(caught.value) for request in allowed(state))


def reachable(state):
    seen, todo = {state}, [state]
    while todo:
        here = todo.pop()
        new = {after for (before, _), after in TRANSITIONS.items() if before is here} - seen
        seen |= new
        todo += new
    return seen


def test_every_state_can_be_reached_and_left():
    assert reachable(State.IDLE) == set(State)
    for state in set(State) - {State.FINISHED}:
        assert allowed(state) or state is State.ABORTING
        assert State.FINISHED in reachable(state)


@pytest.mark.parametrize("state", sorted(ACTIVE))
def test_an_active_session_can_always_be_stopped_and_can_always_fail(state):
    assert state is State.ABORTING or Action.ABORT in allowed(state)
    assert TRANSITIONS[state, Action.FAIL] is State.FAILED
    assert TRANSITIONS[state, Action.INTERRUPT] is State.INTERRUPTED


@pytest.mark.parametrize("state", sorted(ENDS))
def test_after_an_end_only_a_start_is_possible(state):
    assert set(allowed(state)) <= {Action.START}
    assert (Action.START in allowed(state)) == (state is not State.FINISHED)


class Requests(RuleBasedStateMachine):
    """Random requests to a session whose rig takes one exposure each time it is let."""

    @initialize(data=st.sampled_from(["srf", "calibrate"]))
    def begin(self, data):
        self.folder = self.make_folder() / "session"
        self.session = Session.create(self.folder, parse_plan(PLANS[data]), CONFIG)
        self.launch()

    make_folder = None  # set by the test that runs this machine

    def launch(self):
        self.rig, self.world = fake_rig(CONFIG)
        self.gate, self.at_gate = threading.Semaphore(0), threading.Semaphore(0)
        self.world.on_command = self.halt_at_exposures
        self.report = None
        self.told = []
        self.runner = Runner(self.session, self.rig, on_event=self.told.append)
        self.thread = threading.Thread(target=self.run_session)
        self.thread.start()
        self.settle()

    def halt_at_exposures(self, name):
        if name.startswith("expose"):
            self.at_gate.release()
            assert self.gate.acquire(timeout=PATIENCE_S)

    def run_session(self):
        self.report = self.runner.run()
        self.at_gate.release()

    def settle(self):
        """Until the run stands before an exposure, is paused, or has ended."""
        while self.runner.state is not State.PAUSED:
            if self.at_gate.acquire(timeout=0.01):
                self.waits = self.report is None
                return
        self.waits = False

    @property
    def ended(self):
        return self.report is not None

    @precondition(lambda self: not self.ended and self.waits)
    @rule()
    def let_one_exposure_pass(self):
        self.gate.release()
        self.settle()

    @precondition(lambda self: not self.ended)
    @rule(action=st.sampled_from([Action.PAUSE, Action.RESUME, Action.STOP, Action.ABORT]))
    def ask(self, action):
        before = self.runner.state
        request = {
            Action.PAUSE: self.runner.pause, Action.RESUME: self.runner.resume,
            Action.STOP: self.runner.stop, Action.ABORT: self.runner.abort,
        }[action]  # fmt: skip
        if (before, action) not in TRANSITIONS:
            with pytest.raises(StateError):
                request()
            assert self.runner.state is before
            return
        request()
        if before is State.PAUSED:
            self.settle()
        assert action is not Action.ABORT or self.runner.state in (State.ABORTING, State.ABORTED)

    @precondition(lambda self: self.ended and self.session.state is not State.FINISHED)
    @rule()
    def take_up_again(self):
        self.thread.join(PATIENCE_S)
        self.launch()

    @precondition(lambda self: self.ended and self.session.state is State.FINISHED)
    @rule()
    def a_finished_one_does_not_start(self):
        commands = len(self.world.commands)
        with pytest.raises(StateError, match="finished"):
            Runner(self.session, self.rig).run()
        assert len(self.world.commands) == commands

    @invariant()
    def lights_only_while_taking(self):
        if not hasattr(self, "runner"):
            return
        if self.ended or self.runner.state is State.PAUSED:
            assert is_safe(self.rig, self.world)
        assert self.world.offences == []
        if self.ended:
            assert self.report.state in ENDS
            assert self.session.state is self.report.state
            assert (self.report.state is State.FINISHED) == (not self.session.remaining())

    def teardown(self):
        if not hasattr(self, "runner"):
            return
        if self.thread.is_alive() and Action.ABORT in allowed(self.runner.state):
            self.runner.abort()
        while self.thread.is_alive():
            self.gate.release()
            self.thread.join(0.05)
        steps = [(event.kind, event.step) for event in self.session.events() if event.kind == "done"]
        assert len(steps) == len(set(steps)) == len(self.session.done())
        assert self.session.verify() == sum(len(s.cameras) for s in self.session.steps if s.id in self.session.done())
        self.session.close()


def test_any_sequence_of_requests_leaves_a_legal_state_and_a_safe_rig(tmp_path_factory):
    class Machines(Requests):
        def make_folder(self):
            return tmp_path_factory.mktemp("requests")

    Machines.TestCase.settings = settings(max_examples=15, stateful_step_count=25, deadline=None)
    Machines.TestCase("runTest").runTest()


def test_requests_are_the_operators_actions():
    assert set(REQUESTS) == {Action.START, Action.PAUSE, Action.RESUME, Action.STOP, Action.ABORT}
