"""Every error body of the REST service is problem+json (RFC 9457) with a stable code."""

from collections.abc import Mapping
from http import HTTPStatus

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from service.problems import DEFECT, PROBLEMS, problem_of

CONTENT_TOO_LARGE = 413


def report_problems(app: FastAPI) -> None:
    """Answer errors of the product, of the request and of the program alike."""
    for kind in (*PROBLEMS, OSError):
        app.add_exception_handler(kind, _expected)
    app.add_exception_handler(RequestValidationError, _malformed)
    app.add_exception_handler(HTTPException, _refused)
    app.add_exception_handler(Exception, _defect)


def problem_response(status: int, code: str, detail: str, headers: Mapping[str, str] | None = None) -> JSONResponse:
    """The body of one error."""
    body = {"type": f"/problems/{code}", "title": HTTPStatus(status).phrase, "status": status, "code": code,
            "detail": detail}  # fmt: skip
    return JSONResponse(body, status, headers, media_type="application/problem+json")


async def _expected(request: Request, error: Exception) -> JSONResponse:
    problem = problem_of(error)
    if problem is None:
        raise error
    return problem_response(problem.status, problem.code, str(error))


async def _malformed(request: Request, error: Exception) -> JSONResponse:
    """What is not JSON is a bad request; an address whose parts cannot be is one of nothing; else the content is at
    fault (RFC 9110, 15.5)."""
    assert isinstance(error, RequestValidationError)
    first = error.errors()[0]
    detail = f"{'.'.join(str(part) for part in first['loc'])}: {first['msg']}"
    if first["loc"][0] == "path":
        return problem_response(404, "not-found", detail)
    return problem_response(400 if first["type"] == "json_invalid" else 422, "malformed-request", detail)


async def _refused(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)
    status = HTTPStatus(error.status_code)
    # Python 3.13 words this status as RFC 9110 does and 3.11 does not; a code must not depend on that.
    code = "content-too-large" if status == CONTENT_TOO_LARGE else status.phrase.lower().replace(" ", "-")
    return problem_response(status, code, str(error.detail), error.headers)


async def _defect(request: Request, error: Exception) -> JSONResponse:
    return problem_response(DEFECT.status, DEFECT.code, "a defect of this program; its log has the traceback.")
