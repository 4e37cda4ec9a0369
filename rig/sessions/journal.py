"""The journal of one session: what is to be done, what is done, and everything that happened. SQLite, synchronous.

A step is `open`, then `taken` once it was begun, `done` once all of its frames are durable, or `failed`. Its frames and
the mark `done` enter in one transaction, after the files are on disk. What is not done is to be taken: that alone is
how a session resumes.
"""

import json
import shutil
import sqlite3
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import astuple, dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rig.errors import DiskFullError, StoreError
from rig.sessions.step import Step, read_step, step_data

_PAGES_BYTES = 65_536  # what the log grows by in one transaction, and then some
_SCHEMA = """
CREATE TABLE steps (id TEXT PRIMARY KEY, ordinal INTEGER NOT NULL UNIQUE, content TEXT NOT NULL,
                    state TEXT NOT NULL DEFAULT 'open', attempts INTEGER NOT NULL DEFAULT 0);
CREATE TABLE frames (step TEXT NOT NULL REFERENCES steps (id), camera TEXT NOT NULL, path TEXT NOT NULL,
                     sha256 TEXT NOT NULL, bytes INTEGER NOT NULL, exposure_s REAL NOT NULL, frames INTEGER NOT NULL,
                     taken_s REAL NOT NULL, utc TEXT NOT NULL, commanded_rad TEXT NOT NULL, reported_rad TEXT NOT NULL,
                     PRIMARY KEY (step, camera));
CREATE TABLE events (number INTEGER PRIMARY KEY AUTOINCREMENT, utc TEXT NOT NULL, rig_s REAL NOT NULL,
                     kind TEXT NOT NULL, step TEXT, text TEXT NOT NULL);
CREATE TABLE status (key TEXT PRIMARY KEY, value TEXT NOT NULL);
"""


@dataclass(frozen=True, slots=True)
class FrameEntry:
    """One durable file of one camera. `path` is relative to the session folder; `sha256` as `store` defines it."""

    step: str
    camera: str
    path: str
    sha256: str
    bytes: int
    exposure_s: float
    frames: int
    taken_s: float
    utc: str
    commanded_rad: Mapping[str, float]
    reported_rad: Mapping[str, float]


_FRAME_COLUMNS = ", ".join(column.name for column in fields(FrameEntry))


@dataclass(frozen=True, slots=True)
class JournalEvent:
    """Something that happened. `rig_s` is the rig clock's time, `utc` ISO 8601."""

    number: int
    utc: str
    rig_s: float
    kind: str
    step: str | None
    text: str


def utc_now() -> str:
    """The time as the journal writes it: ISO 8601, UTC, microseconds."""
    return datetime.now(UTC).isoformat(timespec="microseconds")


class Journal:
    """One open journal; may be used from several threads. Raises StoreError, DiskFullError where the disk is full."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.RLock()
        with self._reported(), ExitStack() as on_failure:
            self._db = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=30)
            on_failure.callback(self._db.close)
            self._db.execute("PRAGMA journal_mode=WAL")
            self._db.execute("PRAGMA synchronous=FULL")
            on_failure.pop_all()

    @classmethod
    def create(cls, path: Path, steps: Sequence[Step]) -> "Journal":
        """A new journal with all steps open."""
        journal = cls(path)
        try:
            with journal._transaction() as db:
                for statement in filter(str.strip, _SCHEMA.split(";")):
                    db.execute(statement)
                rows = [(step.id, place, json.dumps(step_data(step))) for place, step in enumerate(steps)]
                db.executemany("INSERT INTO steps (id, ordinal, content) VALUES (?, ?, ?)", rows)
        except BaseException:
            journal.close()
            raise
        return journal

    @classmethod
    def open(cls, path: Path) -> "Journal":
        """An existing journal. Raises StoreError where the file is missing or not a journal."""
        if not path.is_file():
            raise StoreError(f"{path}: the session's journal is missing.")
        journal = cls(path)
        try:
            journal.steps()
        except BaseException:
            journal.close()
            raise
        return journal

    def close(self) -> None:
        """Close it; what the write-ahead log holds is folded into the one file first."""
        with self._lock:
            self._db.close()

    def steps(self) -> tuple[Step, ...]:
        """All steps in their order. Raises StoreError where one cannot be read."""
        try:
            return tuple(
                read_step(json.loads(row[0])) for row in self._rows("SELECT content FROM steps ORDER BY ordinal")
            )
        except (ValueError, KeyError, TypeError) as error:
            raise StoreError(f"{self._path}: a step cannot be read: {error!r}.") from error

    def done(self) -> frozenset[str]:
        """Ids of the steps whose frames are all durable."""
        return frozenset(row[0] for row in self._rows("SELECT id FROM steps WHERE state = 'done'"))

    def attempts(self, step: str) -> int:
        """How often this step was begun."""
        return int(self._rows("SELECT attempts FROM steps WHERE id = ?", step)[0][0])

    def frames(self) -> tuple[FrameEntry, ...]:
        """All durable frames, in the order of the steps."""
        rows = self._rows(
            f"SELECT {_FRAME_COLUMNS} FROM frames JOIN steps ON steps.id = frames.step "
            "WHERE steps.state = 'done' ORDER BY ordinal, camera"
        )
        return tuple(FrameEntry(*row[:9], *map(json.loads, row[9:])) for row in rows)

    def events(self, after: int = 0) -> tuple[JournalEvent, ...]:
        """What happened since the event of that number."""
        rows = self._rows(
            "SELECT number, utc, rig_s, kind, step, text FROM events WHERE number > ? ORDER BY number", after
        )
        return tuple(JournalEvent(*row) for row in rows)

    def begin(self, step: str, rig_s: float, text: str) -> int:
        """Write down the intent to take this step; returns the event's number."""
        with self._transaction() as db:
            db.execute("UPDATE steps SET state = 'taken', attempts = attempts + 1 WHERE id = ?", (step,))
            return _insert_event(db, rig_s, "step", step, text)

    def complete(self, step: str, frames: Sequence[FrameEntry], rig_s: float, text: str) -> int:
        """Enter a step's frames and mark it done, at once; returns the event's number."""
        with self._transaction() as db:
            for frame in frames:
                values = [json.dumps(value) if isinstance(value, Mapping) else value for value in astuple(frame)]
                marks = ", ".join("?" * len(values))
                db.execute(f"INSERT INTO frames ({_FRAME_COLUMNS}) VALUES ({marks})", values)
            db.execute("UPDATE steps SET state = 'done' WHERE id = ?", (step,))
            return _insert_event(db, rig_s, "done", step, text)

    def choose(self, test: str, chosen: Sequence[Step], rig_s: float, text: str) -> int:
        """Enter what a test sweep chose for other steps and mark it done, at once; returns the event's number."""
        with self._transaction() as db:
            rows = [(json.dumps(step_data(step)), step.id) for step in chosen]
            db.executemany("UPDATE steps SET content = ? WHERE id = ?", rows)
            db.execute("UPDATE steps SET state = 'done' WHERE id = ?", (test,))
            return _insert_event(db, rig_s, "done", test, text)

    def fail(self, step: str, rig_s: float, reason: str) -> int:
        """Mark a step as failed; it counts as not done. Returns the event's number."""
        with self._transaction() as db:
            db.execute("UPDATE steps SET state = 'failed' WHERE id = ?", (step,))
            return _insert_event(db, rig_s, "failed", step, reason)

    def record(self, kind: str, text: str, rig_s: float, step: str | None = None) -> int:
        """Write down what happened; returns the event's number."""
        with self._transaction() as db:
            return _insert_event(db, rig_s, kind, step, text)

    def enter_state(self, state: str, rig_s: float, text: str) -> int:
        """Write down the session's state with its event; returns the event's number."""
        with self._transaction() as db:
            _put(db, "state", state)
            return _insert_event(db, rig_s, "state", None, text)

    def status(self, key: str, default: str) -> str:
        """A value kept by `put_status` or `enter_state` (key 'state')."""
        rows = self._rows("SELECT value FROM status WHERE key = ?", key)
        return str(rows[0][0]) if rows else default

    def put_status(self, key: str, value: str) -> None:
        """Keep a value across restarts."""
        with self._transaction() as db:
            _put(db, key, value)

    def _rows(self, query: str, *values: object) -> list[Any]:
        with self._lock, self._reported():
            return self._db.execute(query, values).fetchall()

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        with self._lock, self._reported():
            try:
                self._db.execute("BEGIN IMMEDIATE")
                yield self._db
                self._db.execute("COMMIT")
            except BaseException:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise

    @contextmanager
    def _reported(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            if self._is_full(error):
                raise DiskFullError(
                    f"{self._path}: the disk is full; the step stays open. Make room and resume."
                ) from error
            raise StoreError(f"{self._path}: not a readable journal: {error}.") from error

    def _is_full(self, error: sqlite3.Error) -> bool:
        """SQLite tells a full disk as such, or as an I/O error where its shared memory or its log cannot grow."""
        kind = getattr(error, "sqlite_errorcode", 0) & 0xFF
        no_room = shutil.disk_usage(self._path.parent).free < _PAGES_BYTES
        return kind == sqlite3.SQLITE_FULL or (kind == sqlite3.SQLITE_IOERR and no_room)


def _put(db: sqlite3.Connection, key: str, value: str) -> None:
    db.execute("INSERT INTO status VALUES (?, ?) ON CONFLICT (key) DO UPDATE SET value = excluded.value", (key, value))


def _insert_event(db: sqlite3.Connection, rig_s: float, kind: str, step: str | None, text: str) -> int:
    cursor = db.execute(
        "INSERT INTO events (utc, rig_s, kind, step, text) VALUES (?, ?, ?, ?, ?)", (utc_now(), rig_s, kind, step, text)
    )
    return int(cursor.lastrowid or 0)
