"""Jobs: processing a session in the background."""

from typing import Annotated, Any

from fastapi import APIRouter, Body, Response

from rig.sessions import Session
from service.jobs import Job
from service.pipeline import process
from service.routes.dependencies import Host, JobList

router = APIRouter(tags=["jobs"])


@router.post("/sessions/{session_id}/process", status_code=201)
def process_session(
    session_id: str,
    host: Host,
    jobs: JobList,
    response: Response,
    calibrations: Annotated[list[str] | None, Body(embed=True)] = None,
) -> dict[str, Any]:
    """Make the session's products; `calibrations` are the ids of the sessions that measured the rig."""
    folder = host.folder_of(session_id)
    calibrated = [host.folder_of(name) for name in calibrations or []]

    def work(progress: Job) -> None:
        with Session.open(folder) as session:
            process(session, calibrated, progress)

    job = jobs.submit(f"process {session_id}", work)
    response.headers["Location"] = f"/api/v1/jobs/{job}"
    return jobs.read(job)


@router.get("/jobs/{job_id}")
def read_job(job_id: int, jobs: JobList) -> dict[str, Any]:
    """State and progress of one job; a failed one carries its problem."""
    return jobs.read(job_id)


@router.delete("/jobs/{job_id}", status_code=202)
def cancel_job(job_id: int, jobs: JobList) -> dict[str, Any]:
    """Ask a job to end at its next step; products that are whole stay."""
    jobs.cancel(job_id)
    return jobs.read(job_id)
