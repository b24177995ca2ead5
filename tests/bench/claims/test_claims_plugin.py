"""The pytest plugin, in runs of pytest within this one; and what importing it costs."""

import contextlib
import io
import json
import subprocess
import sys

import pytest
import tomli_w
from scenes_small import run_cli, write_scene

BASE = {"scene": "small.toml", "quantity": "smooth_rms_px.u", "repeats": 2}
TRUE = BASE | {"name": "true", "max": 1.0}
FALSE = BASE | {"name": "false", "max": 0.001}
#: The step is unbiased to within what four scans can tell (seed 0 of this scene).
OPEN = BASE | {"name": "open", "quantity": "step[1].deviation_mm", "max": 0.0, "repeats": 4}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    write_scene(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run_pytest(*arguments):
    """Run pytest in this process and return its status and what it printed."""
    printed = io.StringIO()
    options = ("-p", "no:cacheprovider", "-p", "no:faulthandler", "--capture=sys")
    with contextlib.redirect_stdout(printed):
        status = pytest.main(["--strict-markers", *options, *arguments])
    return status, printed.getvalue()


def claims(folder, *tables, name="some.claims.toml"):
    (folder / name).write_text(tomli_w.dumps({"claim": list(tables)}))


def test_one_item_a_claim_and_one_line_a_failure(folder):
    claims(
        folder,
        TRUE,
        FALSE,
        OPEN,
        TRUE | {"name": "missing", "quantity": "step[9].error_mm"},
    )
    status, printed = run_pytest("-q", "-rA")
    assert status == 1
    assert "3 failed, 1 passed" in printed
    assert "PASSED some.claims.toml::true" in printed
    assert "fails: smooth_rms_px.u = 0.0" in printed
    assert "undecided: step[1].deviation_mm" in printed
    assert "repeats would decide" in printed
    assert 'claim "missing": quantity: expected' in printed
    assert "Traceback" not in printed
    assert "pools.py" not in printed


def test_settings_markers_and_a_file_that_is_refused(folder):
    claims(folder, TRUE | {"slow": True}, TRUE | {"name": "quick"})
    claims(folder, TRUE | {"maximum": 1.0}, name="bad.claims.toml")
    (folder / "pytest.ini").write_text("[pytest]\nclaims_seed = 4\nclaims_preview = true\n")
    options = ("-m", "not slow", "--claims-seed", "5", "--continue-on-collection-errors")
    status, printed = run_pytest("-q", "-rA", *options)
    assert status == 1
    assert "1 passed, 1 deselected, 1 error" in printed
    assert "holds: smooth_rms_px.u" in printed
    assert 'bad.claims.toml: claim "true": expected one of the keys scene, ' in printed
    assert "Traceback" not in printed


def test_a_baseline_beside_the_file_is_compared(folder):
    claims(folder, TRUE, TRUE | {"name": "worse"})
    assert run_cli("check", folder / "some.claims.toml", "--update").status == 0
    kept = folder / "some.claims.baseline.json"
    content = json.loads(kept.read_text())
    # As if the scans had once been a tenth as noisy.
    content["claims"]["worse"]["values"] = [x / 10 for x in content["claims"]["true"]["values"]]
    kept.write_text(json.dumps(content))
    _, printed = run_pytest("-q")
    assert "1 failed, 1 passed" in printed
    assert "regressed: smooth_rms_px.u" in printed


def test_a_seed_that_is_none(folder):
    claims(folder, TRUE)
    status, printed = run_pytest("-q", "-o", "claims_seed=x")
    assert status == 1
    assert "claims_seed: expected a whole number, zero or more, got x" in printed
    assert "Traceback" not in printed


def test_importing_the_plugin_loads_nothing_heavy():
    heavy = ["mitsuba", "drjit", "numba", "cv2", "matplotlib", "numpy", "scipy", "pydantic"]
    code = (
        "import sys, slbench.bench.claims.pytest_plugin\n"
        f"print(sorted(set({heavy!r}) & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_a_suite_without_claims_loads_nothing_heavy(tmp_path):
    code = "import sys\ndef test_it():\n    assert not {'numba', 'cv2', 'mitsuba', 'matplotlib'} "
    (tmp_path / "test_plain.py").write_text(code + "& set(sys.modules)\n")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-q"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout
