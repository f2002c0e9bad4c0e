"""The FMUs and results that the tests of cosim have."""

from tests.cosim.conftest import design, fmus, made_result

__all__ = ["design", "fmus", "made_result"]
