"""The doctor and the self-test: right where all is well, and not fooled where it is not."""

import io
import json
import math
import os
import sys

import numpy as np
import pytest
from rich.console import Console

from slbench.simulate import doctor
from slbench.simulate.render.backend import selftest


def printed(diagnosis):
    console = Console(width=200, record=True, file=io.StringIO())
    console.print(doctor.report(diagnosis))
    return console.export_text()


class TestSelfTest:
    def test_the_expected_picture(self):
        picture = selftest.expected_radiance()
        # Straight under the light, at (0.5, 0.75) and 1.5 high, cos = 1: rho I / (pi h^2).
        # The four pixels around that point lie 0.0078 off it, which costs 1.5 (0.011 / 1.5)^2
        # = 8e-5 of the radiance.
        peak = 0.5 * 10 / (math.pi * 1.5**2)
        assert picture[15:17, 95:97] == pytest.approx(peak, rel=1e-4)
        assert picture.max() < peak
        assert np.unravel_index(picture.argmax(), picture.shape) in [
            (v, u) for v in (15, 16) for u in (95, 96)
        ]

    def test_mitsuba_passes(self):
        outcome = selftest.run()
        assert outcome.ok
        # The mean of 16384 pixels, each within 7e-5 (see TOLERANCE); the bound is for the
        # systematic part, curvature and single precision.
        assert outcome.measured == pytest.approx(outcome.expected, rel=2e-5)

    @pytest.mark.parametrize(
        "wrong",
        [
            lambda picture: picture * 1.002,
            lambda picture: picture[::-1],
            lambda picture: picture[:, ::-1],
            lambda picture: np.roll(picture, 1, axis=1),
            lambda picture: np.full_like(picture, math.nan),
        ],
        ids=["brighter", "upside down", "mirrored", "shifted", "nan"],
    )
    def test_a_wrong_picture_fails(self, wrong, monkeypatch):
        right = selftest.expected_radiance()
        monkeypatch.setattr(selftest, "rendered_radiance", lambda: wrong(right))
        assert not selftest.run().ok


class TestDiagnose:
    def test_a_working_machine(self):
        diagnosis = doctor.diagnose()
        assert diagnosis["status"] == "ok", diagnosis
        assert doctor.exit_status(diagnosis) == 0
        assert json.loads(json.dumps(diagnosis)) == diagnosis
        assert diagnosis["packages"]["mitsuba"] is not None
        assert (diagnosis["gpu"]["name"] is None) != (diagnosis["gpu"]["problem"] is None)
        text = printed(diagnosis)
        for word in ("mitsuba 3.", diagnosis["backend"]["variant"], "self-test", "expected"):
            assert word in text

    def test_no_backend(self, monkeypatch, tmp_path):
        monkeypatch.setenv("SLBENCH_VARIANT", "llvm_ad_mono")
        monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "libLLVM-14.so.1"))
        diagnosis = doctor.diagnose()
        assert diagnosis["selftest"] is None
        assert doctor.exit_status(diagnosis) == 2
        assert "karellen-llvm-core" in printed(diagnosis) or sys.platform != "linux"

    def test_a_missing_package_is_reported(self, monkeypatch):
        monkeypatch.setattr(doctor, "PACKAGES", ("no-such-package",))
        assert "no-such-package MISSING" in printed(doctor.diagnose())

    def test_a_failed_self_test(self, monkeypatch):
        failed = {
            "expected": 1.0,
            "measured": 1.1,
            "relative_difference": 0.1,
            "tolerance": 1e-3,
            "seconds": 0.5,
            "ok": False,
        }
        monkeypatch.setattr(doctor, "_selftest", lambda: failed)
        diagnosis = doctor.diagnose()
        assert doctor.exit_status(diagnosis) == 1
        assert "self-test failed" in printed(diagnosis)

    @pytest.mark.skipif(os.name != "posix", reason="a shell script stands in for Python")
    def test_survives_an_abort_of_the_render(self, monkeypatch, tmp_path):
        stand_in = tmp_path / "python"
        stand_in.write_text("#!/bin/sh\necho 'LLVM ERROR: Cannot select' >&2\nkill -ABRT $$\n")
        stand_in.chmod(0o755)
        monkeypatch.setattr(sys, "executable", str(stand_in))
        error = doctor._selftest()["error"]
        assert "SIGABRT" in error
        assert "Cannot select" in error
