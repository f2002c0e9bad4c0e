"""A tiny study of section V with its design files written, and numbers of its runs that are the printed ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from cosim.paper import printed
from cosim.paper.study import Size, Study


@pytest.fixture(scope="session")
def tiny_size():
    return Size(
        draws=1,
        beyond=False,
        sample_times=(1e-4,),  # that of the reference runs, so that claims have draws
        other_sample_times=(1e-3,),
        other_gains=(0,),
        swing_ups=2,
        chattering_draws=1,
        a_mins=(1.0, 0.8),
    )


@pytest.fixture(scope="session")
def study(tmp_path_factory, fmus, tiny_size):
    """The tiny study, prepared but not run."""
    prepared = Study(tmp_path_factory.mktemp("paper"), fmus, tiny_size)
    prepared.prepare()
    return prepared


@pytest.fixture
def as_printed(tiny_size):
    """Make numbers for every run of the study, eight draws, that say what the paper says."""
    study = Study(Path(), Path(), replace(tiny_size, draws=8, swing_ups=8))

    def numbers(key):
        law = next(law for law in ("LC", "IHC", "SMC") if key.variant.startswith(law))
        over = printed.ENERGY_OVER.get(law, 0.0) if key.gain == 0 else 0.0
        factor = 0.9 if law == "IHC" else 1.0
        return {
            "integral_q2": printed.LMSE[key.gain][law],
            "energy": 1000.0 / (1.0 + over),
            "energy_after_capture": 100.0 / (1.0 + over),
            "settling_wide": 3.0 * factor,
            "settling_time": 4.0 * factor,
            **dict.fromkeys(("window_rms", "window_theta", "window_delta", "steady_rms"), 0.02 * factor),
            "voltage_variation": 5.0 / factor,
            "arm_peak": 1.5,
            "capture_time": printed.SWITCH_TIME,
            "kept": 1.0,
        }

    return lambda: {key: numbers(key) for keys in study.keys().values() for key in keys}
