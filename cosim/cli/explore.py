"""The command `explore`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import UserError
from .display import console, escaped, problems, say_notes
from .options import SCENARIO_HELP, FmusOption, SetOption, assignments


def explore(
    scenario: Annotated[str, typer.Argument(help=SCENARIO_HELP)],
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of this machine (127.0.0.1); 0: a free one.")] = 0,
    browser: Annotated[bool, typer.Option(help="Open the page in the browser.")] = True,
    fmus: FmusOption = Path("fmus"),
    change: SetOption = None,
) -> None:
    """Open a local page with sliders for a scenario's parameters, initial state and disturbance.

    The curves and metrics of the laws follow while a slider moves; a button writes the scenario as it stands. Ctrl-C ends
    the server.
    """
    try:
        from ..explore.server import listening, serve
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] in ("fastapi", "nicegui", "uvicorn"):
            raise UserError('explore needs NiceGUI: pip install "qube-ihc[explore]"') from None
        raise
    from ..explore.exploration import Exploration
    from ..remarks import remarks_before
    from ..scenario import load_located
    from ..scenario_system import build_system

    with listening(port) as place:
        loaded, folder, place_of_fmus = load_located(scenario, fmus)
        loaded = loaded.changed(dict(assignments(change)))
        say_notes(remarks_before(build_system(loaded, place_of_fmus, folder), loaded))
        arguments = [scenario, *(["--fmus", str(fmus)] if fmus != Path("fmus") else [])]
        arguments += [part for one in change or [] for part in ("--set", one)]
        with problems.status("running the scenario"):
            exploration = Exploration(loaded, folder, place_of_fmus, arguments)
            exploration.warm()
        serve(
            exploration,
            place,
            browser=browser,
            ready=lambda address: console.print(f"{escaped(loaded.name)} on {address}; Ctrl-C ends it", soft_wrap=True),
        )
