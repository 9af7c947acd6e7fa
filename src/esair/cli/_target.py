"""A robot of a module: ``module:robot``, or ``file.py:robot``."""

from __future__ import annotations

from esair.config import FoundInFile, Report, find_robot
from esair.plan import Finding, examine, protection


def check_robot(target: str) -> Report:
    """Find every mistake of a robot of a module, without starting it."""
    plan = find_robot(target).plan
    findings = [_shown(each) for each in examine(plan)]
    findings.sort(key=lambda each: each.severity)
    return Report(
        file=target,
        digest="",
        findings=tuple(findings),
        actuators=tuple(protection(plan)),
        with_simulation=False,
    )


def _shown(finding: Finding) -> FoundInFile:
    where = ".".join(each for each in (finding.component, finding.field) if each)
    return FoundInFile(finding.severity.value, finding.rule, where, None, finding.text)
