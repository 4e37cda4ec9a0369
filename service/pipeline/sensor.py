"""Sensors from the dark and flat frames of a `sensor` session: one product folder per camera's serial number."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from processing.errors import CalibrationError, ImageError
from processing.formats.raw import RawImage, read_raw
from processing.radiometry.frame_series import Frame
from processing.radiometry.photon_transfer import measure_sensor
from processing.radiometry.sensor_calibration import SensorCalibration
from rig.sessions import CAP, LIGHT_BOX, FrameRecord, Session
from service.pictures import draw_sensor
from service.pipeline.calibrations import SENSORS
from service.pipeline.inputs import Progress, fingerprint, is_current, provenance

PICTURE = "picture.png"


def make_sensors(session: Session, progress: Progress) -> list[Path]:
    """What photon transfer says of every camera's sensor, and a picture of it."""
    by_camera: dict[str, list[FrameRecord]] = {}
    for record in session.frames():
        by_camera.setdefault(record.camera, []).append(record)
    return [_make_sensor(session, by_camera[camera]) for camera in progress.track(list(by_camera), "measuring sensors")]


def _make_sensor(session: Session, records: Sequence[FrameRecord]) -> Path:
    first = read_raw(records[0].path)
    folder = session.products / SENSORS / (first.serial or records[0].camera)
    if is_current(folder, inputs := fingerprint(records, {})) and (folder / PICTURE).is_file():
        return folder
    try:
        measurement = measure_sensor(
            _exposures(records, CAP, first), _exposures(records, LIGHT_BOX, first), first.sensor
        )
    except (CalibrationError, ImageError) as error:
        raise type(error)(f"{records[0].camera} ({first.serial}): {error}") from error
    source = provenance(session, inputs)
    SensorCalibration(first.serial, first.model, first.iso, first.sensor, measurement, records[0].utc, source).save(
        folder
    )
    draw_sensor(folder, folder / PICTURE)
    return folder


def _exposures(
    records: Sequence[FrameRecord], before_lens: str, first: RawImage
) -> Iterator[tuple[float, Iterator[Frame]]]:
    """The exposures with this before the lens: darks fall, flats rise; frames are read when asked for."""
    mine = [record for record in records if (record.step.mount or {}).get("sample") == before_lens]
    for exposure_s in sorted({record.step.exposure_s for record in mine}, reverse=before_lens == CAP):
        yield exposure_s, _frames([record for record in mine if record.step.exposure_s == exposure_s], first)


def _frames(records: Sequence[FrameRecord], first: RawImage) -> Iterator[Frame]:
    for record in records:
        raw = read_raw(record.path)
        if (raw.serial, raw.iso, raw.sensor) != (first.serial, first.iso, first.sensor):
            raise ImageError(f"{record.path}: another camera or setting than the other frames.")
        yield Frame(raw.mosaic, record.taken_s)
