"""Capture sessions: plans, their steps, the journal, the runner, and the folder that holds it all."""

from rig.sessions.forecast import Forecast, forecast
from rig.sessions.journal import JournalEvent
from rig.sessions.lock import hold_rig
from rig.sessions.plan import (
    BtfPlan,
    CalibratePlan,
    Card,
    EnvironmentPlan,
    LampsPlan,
    MdfPlan,
    Plan,
    SensorPlan,
    SrfPlan,
    load_plan,
    parse_plan,
    plan_data,
    plan_schema,
    plan_sha256,
)
from rig.sessions.planner import CAP, LIGHT_BOX, Schedule, Skip, expand, schedule
from rig.sessions.progress import Event
from rig.sessions.runner import Operator, Runner, RunReport
from rig.sessions.session import FrameRecord, Session
from rig.sessions.states import ACTIVE, TRANSITIONS, Action, State, allowed
from rig.sessions.step import Step, describe

__all__ = [
    "ACTIVE", "CAP", "LIGHT_BOX", "TRANSITIONS", "Action", "BtfPlan", "CalibratePlan", "Card", "EnvironmentPlan",
    "Event", "Forecast", "FrameRecord", "JournalEvent", "LampsPlan", "MdfPlan", "Operator", "Plan", "RunReport",
    "Runner", "Schedule", "SensorPlan", "Session", "Skip", "SrfPlan", "State", "Step", "allowed", "describe", "expand",
    "forecast", "hold_rig", "load_plan", "parse_plan", "plan_data", "plan_schema", "plan_sha256", "schedule",
]  # fmt: skip
