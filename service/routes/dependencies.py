"""What routes are given: the application's sessions, jobs, relightings and scenes."""

from typing import Annotated

from fastapi import Depends, Request

from service.host import SessionHost
from service.jobs import Jobs
from service.relightings import Relightings
from service.scene_folder import SceneFolder


def _host(request: Request) -> SessionHost:
    host: SessionHost = request.app.state.host
    return host


def _jobs(request: Request) -> Jobs:
    jobs: Jobs = request.app.state.jobs
    return jobs


def _relightings(request: Request) -> Relightings:
    relightings: Relightings = request.app.state.relightings
    return relightings


def _scenes(request: Request) -> SceneFolder:
    scenes: SceneFolder = request.app.state.scenes
    return scenes


Host = Annotated[SessionHost, Depends(_host)]
JobList = Annotated[Jobs, Depends(_jobs)]
RelightingList = Annotated[Relightings, Depends(_relightings)]
Scenes = Annotated[SceneFolder, Depends(_scenes)]
