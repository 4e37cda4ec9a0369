"""Plans: their schema, and whether one can be carried out."""

from dataclasses import asdict
from typing import Any

from fastapi import APIRouter

from rig.sessions import describe, forecast, parse_plan, plan_schema, plan_sha256, schedule
from service.routes.dependencies import Host

router = APIRouter(prefix="/plans", tags=["plans"])


@router.get("/schema")
def read_schema() -> dict[str, Any]:
    """JSON schema of every kind of plan."""
    return plan_schema()


@router.post("/validate")
def validate_plan(plan: dict[str, Any], host: Host, steps: bool = False) -> dict[str, Any]:
    """Check a plan against the rig's limits and forecast its time and size; with `steps` list them all."""
    checked = parse_plan(plan)
    laid_out = schedule(checked, host.config)
    expected = asdict(forecast(laid_out.steps, host.config))
    found = {
        "kind": checked.kind, "sha256": plan_sha256(checked), "steps": len(laid_out.steps), "forecast": expected,
        "skipped": [asdict(skip) for skip in laid_out.skipped],
    }  # fmt: skip
    return {**found, "dry_run": [describe(step) for step in laid_out.steps]} if steps else found
