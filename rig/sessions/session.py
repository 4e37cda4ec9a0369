"""A session is a folder: what was asked for, what was done, and the frames. It can be copied, verified, reprocessed."""

import json
import platform
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Self

from pydantic import ValidationError

from rig.config import RigConfig
from rig.errors import PlanError, StoreError
from rig.interrupts import postponed
from rig.sessions import store
from rig.sessions.forecast import Forecast, forecast
from rig.sessions.journal import Journal, JournalEvent, utc_now
from rig.sessions.lock import hold, is_held
from rig.sessions.plan import Plan, content_sha256, parse_plan, plan_data, plan_sha256
from rig.sessions.planner import Schedule, schedule
from rig.sessions.states import ACTIVE, State
from rig.sessions.step import Step

SCHEMA = 1
_SPARE_BYTES = 16_000_000  # journal, and room for the file system itself
_PACKAGES = ("appearance-rig", "numpy", "rawpy", "zarr")
_FIELDS = {"schema", "id", "kind", "plan", "plan_sha256", "rig", "versions", "created_utc", "clock"}


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """One durable file of one camera and step: a raw file, or a burst of `frames` as a Zarr array (time, row, column).

    `path` is absolute. `sha256` is of the file's bytes, or of the array's values in C order. `taken_s` is the rig
    clock's time of the (first) exposure, `utc` the same moment in UTC. `commanded_rad` and `reported_rad` are the axes'
    angles as they were asked for and as the axes told them.
    """

    step: Step
    camera: str
    path: Path
    sha256: str
    bytes: int
    exposure_s: float
    frames: int
    taken_s: float
    utc: str
    commanded_rad: Mapping[str, float]
    reported_rad: Mapping[str, float]


class Session:
    """One session folder, open. Close it, or use it as a context."""

    def __init__(self, folder: Path, about: Mapping[str, Any], plan: Plan, config: RigConfig, journal: Journal) -> None:
        self.folder = folder
        self.id = str(about["id"])
        self.about = about
        self.plan = plan
        self.config = config
        self.journal = journal
        self.steps: tuple[Step, ...] = journal.steps()

    @classmethod
    def create(cls, folder: Path, plan: Plan, config: RigConfig) -> "Session":
        """A new session in a folder that does not exist yet, or is empty.

        Raises what `schedule` raises, PlanError where the frames would not fit on the disk, StoreError where the folder
        is in use; whatever it raises, nothing is left behind and nothing was overwritten.
        """
        folder = folder.absolute()
        laid_out = schedule(plan, config)
        _check_free(folder)
        _check_disk(folder, forecast(laid_out.steps, config))
        with store.reported(folder):
            folder.parent.mkdir(parents=True, exist_ok=True)
            part = Path(tempfile.mkdtemp(prefix=store.PART_PREFIX, dir=folder.parent))
        try:
            _fill(part, plan, config, laid_out)
            with store.reported(folder):
                part.chmod(0o755)
                store.publish(part, folder)
        except BaseException:
            shutil.rmtree(part, ignore_errors=True)
            raise
        return cls.open(folder)

    @classmethod
    def open(cls, folder: Path) -> "Session":
        """An existing session. Raises StoreError with one message that says what is wrong with the folder."""
        folder = folder.absolute()
        about = _read_about(folder)
        plan, config = _read_plan(folder, about)
        return cls(folder, about, plan, config, Journal.open(folder / "journal.sqlite"))

    def close(self) -> None:
        """Close the journal."""
        self.journal.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def products(self) -> Path:
        """Where what is made from the frames belongs."""
        return self.folder / "products"

    @property
    def state(self) -> State:
        """The state now; `interrupted` where a run ended without saying so."""
        state = State(self.journal.status("state", State.IDLE))
        return State.INTERRUPTED if state in ACTIVE and not is_held(self._lock_file) else state

    @contextmanager
    def exclusive(self) -> Iterator[None]:
        """Hold the folder for a run. Raises BusyError where another process or thread runs it."""
        with hold(self._lock_file, f"the session {self.folder}"):
            crashed = State(self.journal.status("state", State.IDLE)) in ACTIVE
            with store.reported(self.folder):
                store.sweep_away_parts(self.folder / "frames")
            if crashed:
                self.journal.enter_state(State.INTERRUPTED, 0.0, "the last run ended without a word")
            yield

    def done(self) -> frozenset[str]:
        """Ids of the steps whose frames are all durable."""
        return self.journal.done()

    def remaining(self) -> tuple[Step, ...]:
        """The steps that are not done, in order."""
        done = self.done()
        return tuple(step for step in self.steps if step.id not in done)

    def choose_exposure(self, test: Step, exposure_s: float, rig_s: float, text: str) -> int:
        """Give all sweeps of the test sweep's mounting this exposure, durably; returns the event's number."""
        mine = [step for step in self.steps if step.sweep and step.mount == test.mount and not step.test]
        with postponed():  # between the two these steps would be wrong
            number = self.journal.choose(test.id, [replace(step, exposure_s=exposure_s) for step in mine], rig_s, text)
            self.steps = self.journal.steps()
        return number

    def forecast(self) -> Forecast:
        """Time and disk of what remains."""
        return forecast(self.remaining(), self.config)

    def events(self, after: int = 0) -> tuple[JournalEvent, ...]:
        """What happened since the event of that number."""
        return self.journal.events(after)

    def frames(self) -> list[FrameRecord]:
        """All durable frames in the order of the steps. Raises MissingFrameError where one is gone or truncated."""
        steps = {step.id: step for step in self.steps}
        records = []
        for entry in self.journal.frames():
            path = self._inside(entry.path)
            store.check_present(path, entry.bytes)
            records.append(FrameRecord(**{**asdict(entry), "step": steps[entry.step], "path": path}))
        return records

    def verify(self) -> int:
        """Compare every frame with its checksum; returns their number. Raises MissingFrameError for a bad one."""
        records = self.frames()
        for record in records:
            store.check_content(record.path, record.sha256)
        return len(records)

    def timing(self) -> tuple[float, float]:
        """Rig time that all runs took so far, and the lower bound of the same steps, both without preparation."""
        return float(self.journal.status("session_s", "0")), float(self.journal.status("lower_bound_s", "0"))

    def add_timing(self, session_s: float, lower_bound_s: float) -> None:
        """Count one more run into `timing`."""
        before_s, bound_s = self.timing()
        self.journal.put_status("session_s", repr(before_s + session_s))
        self.journal.put_status("lower_bound_s", repr(bound_s + lower_bound_s))

    @property
    def _lock_file(self) -> Path:
        return self.folder / "session.lock"

    def _inside(self, relative: str) -> Path:
        path = self.folder / relative
        if not path.resolve().is_relative_to(self.folder.resolve()):
            raise StoreError(f"{self.folder}: the journal names a frame outside of the session: {relative!r}.")
        return path


def _fill(folder: Path, plan: Plan, config: RigConfig, laid_out: Schedule) -> None:
    """Everything of a new session; the folder gets its name only once this is durable."""
    with store.reported(folder):
        (folder / "frames").mkdir()
        (folder / "products").mkdir()
    journal = Journal.create(folder / "journal.sqlite", laid_out.steps)
    try:
        for skip in laid_out.skipped:
            journal.record("skip", f"{skip.what}: {skip.reason}", 0.0)
    finally:
        journal.close()
    store.write_file(folder / "session.json", json.dumps(_about(plan, config), indent=1).encode())


def _about(plan: Plan, config: RigConfig) -> dict[str, Any]:
    digest = plan_sha256(plan)
    return {
        "schema": SCHEMA,
        "id": f"{plan.kind}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{digest[:8]}",
        "kind": plan.kind,
        "plan": plan_data(plan),
        "plan_sha256": digest,
        "rig": config.model_dump(mode="json"),
        "versions": {"python": platform.python_version(), **{name: _version(name) for name in _PACKAGES}},
        "created_utc": utc_now(),
        "clock": "simulated" if config.clock else "monotonic",
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _read_about(folder: Path) -> dict[str, Any]:
    path = folder / "session.json"
    if not folder.is_dir():
        raise StoreError(f"{folder}: no such session folder.")
    if not path.is_file():
        raise StoreError(f"{folder}: not a session folder: it has no session.json.")
    try:
        about = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise StoreError(f"{path}: cannot be read as JSON: {error}.") from error
    if not isinstance(about, dict) or not _FIELDS <= about.keys():
        raise StoreError(f"{path}: not a session of this product: fields are missing.")
    if about["schema"] != SCHEMA:
        raise StoreError(f"{path}: written in schema {about['schema']!r}; this version reads schema {SCHEMA}.")
    return about


def _read_plan(folder: Path, about: Mapping[str, Any]) -> tuple[Plan, RigConfig]:
    path = folder / "session.json"
    try:
        plan, config = parse_plan(about["plan"], source=str(path)), RigConfig.model_validate(about["rig"])
    except (PlanError, ValidationError) as error:
        raise StoreError(f"{path}: the plan or the rig in it is malformed: {error}") from error
    # Of the plan as it was written: fields that later versions add, with their defaults, do not count as a change.
    if content_sha256(about["plan"]) != about["plan_sha256"]:
        raise StoreError(f"{path}: the plan was changed after the session was created: its hash differs.")
    return plan, config


def _check_free(folder: Path) -> None:
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise StoreError(f"{folder}: exists and is not empty; nothing was overwritten. Name a new folder.")


def _check_disk(folder: Path, wanted: Forecast) -> None:
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    free_bytes = shutil.disk_usage(existing).free
    if wanted.bytes + _SPARE_BYTES > free_bytes:
        raise PlanError(
            f"{wanted.frames} frames need {wanted.bytes / 1e6:.0f} MB and {folder} has {free_bytes / 1e6:.0f} MB free. "
            "Name a folder on a larger disk, or take less out of the plan."
        )
