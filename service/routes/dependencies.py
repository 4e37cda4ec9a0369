"""What routes are given: the application's sessions and jobs."""

from typing import Annotated

from fastapi import Depends, Request

from service.host import SessionHost
from service.jobs import Jobs


def _host(request: Request) -> SessionHost:
    host: SessionHost = request.app.state.host
    return host


def _jobs(request: Request) -> Jobs:
    jobs: Jobs = request.app.state.jobs
    return jobs


Host = Annotated[SessionHost, Depends(_host)]
JobList = Annotated[Jobs, Depends(_jobs)]
