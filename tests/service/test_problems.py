"""Every error that the product can raise is reported in one known way."""

import inspect

import pytest

import processing.errors
import render.errors
import rig.errors
from service.problems import EXIT_CODES, PROBLEMS, problem_of

ERRORS = [
    kind
    for module in (rig.errors, processing.errors, render.errors)
    for _, kind in inspect.getmembers(module, inspect.isclass)
    if issubclass(kind, Exception) and kind.__module__ == module.__name__
]


@pytest.mark.parametrize("kind", ERRORS, ids=lambda kind: kind.__name__)
def test_every_error_of_the_product_is_a_problem(kind):
    problem = problem_of(kind("what was wrong"))
    assert problem is not None
    assert 400 <= problem.status < 600
    assert problem.exit_code in EXIT_CODES


def test_a_subclass_is_reported_like_its_nearest_known_ancestor():
    class CableError(rig.errors.ConnectError):
        pass

    assert problem_of(CableError()) is PROBLEMS[rig.errors.ConnectError]


def test_a_defect_is_no_problem_of_the_users():
    assert problem_of(ZeroDivisionError()) is None


def test_codes_are_distinct():
    codes = [problem.code for problem in PROBLEMS.values()]
    assert len(set(codes)) == len(codes)
