"""`rig join`: the BTF and the MDF of one sample, each of a session of its own, as one material with depth."""

from collections.abc import Iterator
from pathlib import Path

from processing.errors import ImageError
from processing.mesostructure import Joined, mesostructure_from
from processing.products import Mdf, Provenance, StoredBtf
from rig.sessions import BtfPlan, MdfPlan, Session
from service.files import check_folder, filled

_GUESSED = 0.2  # share of the depths that no laser reached from which on it is told as a doubt


def join_sessions(btf_session: Path, mdf_session: Path, out: Path) -> Iterator[str]:
    """Make the product `mesostructure` of two processed sessions in the folder `out`; tells what was found.

    Raises ImageError where the sessions do not belong together or are not processed; then nothing is written.
    """
    check_folder(out)
    with Session.open(btf_session) as btf, Session.open(mdf_session) as mdf:
        _check_pair(btf, mdf)
        joined = _joined(btf, mdf)
    with filled(out) as part:
        joined.mesostructure.save(part)
    made, side_mm = joined.mesostructure, btf.config.holder.texels_mm
    views, height, width = made.depths.shape
    yield f"{views} views of {width} x {height} texels, at most {made.deepest * side_mm:.3g} mm deep"
    doubt = ": lasers from more sides, or higher, would see more" if joined.filled > _GUESSED else ""
    yield f"{joined.filled:.1%} of the depths were not measured and are filled from their neighbours{doubt}"
    left = f"{joined.error:.1%} of what the BTF shows, rms over each texel's mean"
    yield f"{len(made.btf.weights)} eigenmaps leave {left}"
    sizes = f"{made.btf.nbytes / 1e6:.3g} MB of eigenmaps and {made.depths.nbytes / 1e6:.3g} MB of depths"
    yield f"{out}: {sizes}; `rig preview {out} --shape torus` draws it"


def _check_pair(btf: Session, mdf: Session) -> None:
    """Raises ImageError that says in which way the sessions are not of one sample, seen alike."""
    if not isinstance(btf.plan, BtfPlan) or not isinstance(mdf.plan, MdfPlan):
        raise ImageError(
            f"{btf.folder} is of kind {btf.plan.kind} and {mdf.folder} of kind {mdf.plan.kind}: first a btf session, "
            "then an mdf session is needed"
        )
    for what, one, other in (
        ("samples", btf.plan.sample, mdf.plan.sample),
        ("texels", btf.plan.texels, mdf.plan.texels),
        ("depth_mm of the texels", btf.plan.depth_mm, mdf.plan.depth_mm),
        ("sides in mm of the square", btf.config.holder.texels_mm, mdf.config.holder.texels_mm),
    ):
        if one != other:
            raise ImageError(f"{btf.folder} and {mdf.folder} have different {what}: {one} and {other}")


def _joined(btf: Session, mdf: Session) -> Joined:
    """Raises ImageError where a product is missing or the views differ."""
    looks, depths = (_product(*one) for one in ((btf, "btf"), (mdf, "mdf")))
    seen, measured = StoredBtf.open(looks), Mdf.load(depths)
    made_from = {"btf": seen.provenance.parameters, "mdf": measured.provenance.parameters}
    source = Provenance((btf.id, mdf.id), seen.provenance.calibration, made_from)
    try:
        return mesostructure_from(seen, measured, source)
    except ImageError as error:
        raise ImageError(f"{btf.folder} and {mdf.folder} cannot be joined: {error}") from error


def _product(session: Session, name: str) -> Path:
    folder = session.products / name
    if not (folder / "product.json").is_file():
        raise ImageError(f"{session.folder}: has no {name} yet; `rig process {session.folder}` makes it")
    return folder
