"""Options that nobody gave are chosen from the system, with reasons."""

import re
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest

from ihc_fmu.inverse import inverse_design
from ihc_fmu.largest_rate import largest_alpha, largest_alpha_of
from ihc_fmu.lmi import InfeasibleError
from ihc_fmu.options import Options
from ihc_fmu.synthesis import chosen_options
from tests.ihc_fmu.models import integrator_chain, system


def test_options_are_chosen_from_the_system_with_reasons(paper):
    limited = system(*paper).changed(lower=[-10.0], upper=[6.0], u_eq=[1.0])
    choice = chosen_options(limited)
    assert choice.options.mu == 1.0
    assert choice.options.alpha == pytest.approx(0.2715 / 2, rel=0.02)
    assert choice.options.u_max == [2.5]  # half of 6 - 1
    assert [reason.split(" ")[0] for reason in choice.reasons] == ["mu", "alpha", "u_max"]
    assert choice.reasons[2].startswith("u_max = 2.5: ")
    assert inverse_design(limited, choice.options).u_max == pytest.approx(2.5, rel=1e-3)


def test_alpha_is_chosen_under_the_options_given():
    """Half of the largest one with which d_max is rejected, which is about where designs end to be found."""
    given = system(*integrator_chain(2)).changed(K=[[-1.0, -2.0]])
    choice = chosen_options(given, u_max=[0.3], d_max=0.2)
    design = inverse_design(given, choice.options, start=choice.start)
    assert largest_alpha_of(design, choice.options) == pytest.approx(2 * design.alpha, rel=0.02)
    assert "half of the largest one that rejects |d| <= 0.2, found to about 1 %" in choice.reasons[1]
    for factor, holds in ((1.95, True), (2.05, False)):
        with nullcontext() if holds else pytest.raises(InfeasibleError, match="no P proves the rejection"):
            inverse_design(given, replace(choice.options, alpha=factor * design.alpha))
    with pytest.raises(
        InfeasibleError, match=r"^no P proves the rejection of \|d\| <= 0.5 for any alpha down to 2.9e-06"
    ):
        chosen_options(given, u_max=[0.3], d_max=0.5)
    psi = chosen_options(given, u_max=[0.3], psi=1e6)
    assert inverse_design(given, psi.options, start=psi.start).psi == 1e6


def test_degree_is_lowered_for_an_alpha_that_the_highest_one_does_not_allow(paper):
    """The largest alpha is 0.27 at mu = 1, 0.33 at 0.75, 0.44 at 0.5, 0.63 at 0.25."""
    assert chosen_options(system(*paper), alpha=0.4).options.mu == 0.5
    assert chosen_options(system(*paper), alpha=0.2).options.mu == 1.0


def test_what_was_found_for_a_choice_and_a_design_is_used_again(paper):
    """A design from the search of its choice is the same, and its own P leads to the same largest alpha as a new search."""
    choice = chosen_options(system(*paper))
    said, again = [], []
    first = inverse_design(system(*paper), choice.options, said.append, choice.start)
    second = inverse_design(system(*paper), choice.options, again.append)
    assert (len(said), bool(again)) == (0, True)
    np.testing.assert_allclose(first.P, second.P, rtol=1e-6)
    assert largest_alpha_of(first, Options()) == pytest.approx(largest_alpha(system(*paper)), rel=1e-4)
    other = Options(mu=1.0, alpha=0.26, u_max=1.5, beta=0.6)
    assert inverse_design(system(*paper), other, start=choice.start).certificate.monotone > 1.2


def test_what_is_given_stays(paper):
    choice = chosen_options(system(*paper), mu=0.5, alpha=0.1, u_max=[3.0], beta=0.2)
    assert choice.options == Options(mu=0.5, alpha=0.1, u_max=[3.0], beta=0.2)
    assert choice.reasons == ()
    assert chosen_options(system(*paper), mu=1.0, alpha=0.1, delta_max=0.1).options.u_max is None


def test_room_that_no_bound_can_be_chosen_from_is_refused(paper):
    for limit in (1e-12, 1e308):
        given = system(*paper).changed(lower=[-limit], upper=[limit])
        with pytest.raises(
            ValueError,
            match=rf"^limits must leave a room of 2e-09 to 2e.09 .*, found {re.escape(f'{limit:g}')} for u1$",
        ):
            chosen_options(given, 1.0, 0.1)
