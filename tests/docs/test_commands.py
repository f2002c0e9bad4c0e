"""Every command and program in the documentation runs as it is printed, page by page, or is marked there as not run.

A fenced block says its language: `sh`, `python`, `toml` or `text`, which is nothing to run. The marks are comments:
`# not run: REASON` at the end of a command, `<!-- not run: REASON -->` above a block of any language. A `text` block under
`<!-- output -->` has lines that the block before it prints, in their order; numbers may differ by 2 %.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from cosim.paper.study import FULL, Key, Study
from cosim.pendulum_export import export_units
from ihc_fmu.pendulum.start_values import default_design
from tests.cosim.command import PLAIN, ended

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "fmus/README.md")]
PAGES += sorted((ROOT / "docs").glob("*.md"))
STAND_IN = ROOT / "tests" / "cosim" / "hil" / "stand_in"
FENCE = re.compile(
    r"^(?:<!-- (?:not run: (?P<reason>.+?)|(?P<output>output)) -->\n)?```(?P<language>.*?)\n(?P<body>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w.])")
MARK = re.compile(r"# not run: (?P<reason>.+)$")


@dataclass(frozen=True)
class Block:
    """A fenced block: the page, the line of its first line, the language, the text, and why it is not run."""

    page: Path
    line: int
    language: str
    body: str
    reason: str | None
    is_output: bool = False

    @property
    def place(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"

    def marked(self) -> Iterator[tuple[str, str]]:
        """Return what is marked as not run, with the reasons."""
        if self.reason is not None:
            yield self.place, self.reason
        elif self.language == "sh":
            for line in self.body.splitlines():
                if (mark := MARK.search(line)) is not None:
                    yield f"{self.place}: {line.split('  ')[0]}", mark["reason"]

    def script(self) -> str:
        """Return the shell's commands without those marked, each line as it is printed."""
        lines = self.body.splitlines(keepends=True)
        return "".join("\n" if MARK.search(line) else line for line in lines)


def blocks(page: Path) -> list[Block]:
    text = page.read_text(encoding="utf-8")
    assert len(re.findall(r"^ *(```|~~~)", text, re.MULTILINE)) == 2 * len(FENCE.findall(text)), page
    return [
        Block(
            page,
            text.count("\n", 0, m.start("body")) + 1,
            m["language"],
            m["body"],
            m["reason"],
            m["output"] is not None,
        )
        for m in FENCE.finditer(text)
    ]


BLOCKS = [block for page in PAGES for block in blocks(page)]
MARKED = [marked for block in BLOCKS for marked in block.marked()]


@pytest.mark.parametrize("block", BLOCKS, ids=lambda b: b.place)
def test_a_block_says_what_it_is(block):
    assert block.reason is not None or block.language in ("sh", "python", "toml", "text")
    if block.language == "text":
        assert not re.search(r"^(\.venv/bin/|qube-ihc|fmpy|make|pip|python)", block.body, re.MULTILINE)


@pytest.fixture(scope="module")
def left_by_earlier_commands(tmp_path_factory):
    """What a user has after `export`, `hil`, here in lockstep, and `paper`, of which the FMUs and one scenario."""
    folder = tmp_path_factory.mktemp("user")
    export_units(default_design(), output=folder / "fmus")
    done = ended("hil", "--lockstep", "--duration", "4", cwd=folder)
    assert done.returncode == 0, done.stderr
    paper = folder / "results" / "paper"
    paper.mkdir()
    (paper / "fmus").symlink_to("../../fmus")
    study = Study(paper, paper / "fmus", FULL)
    study.prepare()
    study.save_scenario(Key("reference", "ident", 1e-4, 0, "IHC", 0))
    for name in ("run.csv", "run.json"):
        (folder / name).symlink_to(f"results/hil/{name}")
    return folder


@pytest.fixture
def environment(tmp_path, left_by_earlier_commands):
    """A folder and an environment without anything else: the project's commands on the PATH, a stand-in as the board."""
    work, commands, board = tmp_path / "user", Path(sys.prefix) / "bin", tmp_path / "board.json"
    shutil.copytree(left_by_earlier_commands, work, symlinks=True)
    shutil.copytree(ROOT / "examples", work / "examples", ignore=shutil.ignore_patterns("__pycache__", "*.fmu"))
    for name in ("Makefile", "pyproject.toml", "hatch_build.py"):
        shutil.copy(ROOT / name, work)
    (work / ".venv").mkdir()
    (work / ".venv" / "bin").symlink_to(commands)
    (work / ".venv" / "installed").touch()  # for make
    board.write_text(json.dumps({"clock": "steps", "log": str(tmp_path / "board.log")}), encoding="utf-8")
    kept = {name: os.environ[name] for name in ("TMPDIR", "HOME") if name in os.environ}
    path = os.pathsep.join(map(str, (commands, "/usr/local/bin", "/usr/bin", "/bin")))
    return work, kept | PLAIN | {
        "PATH": path,
        "PYTHONPATH": str(STAND_IN),
        "QUBE_STAND_IN": str(board),
        "LC_ALL": "C.UTF-8",
    }


@pytest.mark.skipif(os.name != "posix" or shutil.which("bash") is None, reason="runs the commands with bash")
@pytest.mark.parametrize("page", [p for p in PAGES if any(b.page == p for b in BLOCKS)], ids=lambda p: p.name)
def test_commands_and_programs_run_as_printed(environment, page):
    work, variables = environment
    printed = ""
    for block in blocks(page):
        if block.reason is not None:
            continue
        if block.is_output:
            check_printed(block, printed)
            continue
        if block.language == "sh":
            command = ["bash", "-euv", "-c", block.script()]
        elif block.language == "python":
            command = [sys.executable, "-W", "error::DeprecationWarning:__main__", "-c", block.body]
        else:
            if (name := re.match(r"# (\S+\.toml)\n", block.body)) is not None:
                (work / name[1]).write_text(block.body, encoding="utf-8")
            continue
        done = subprocess.run(
            command, cwd=work, env=variables, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False
        )
        assert done.returncode == 0, f"{block.place}\n{done.stdout}\n{done.stderr}"
        assert "Traceback" not in done.stderr
        printed = done.stdout


def check_printed(block, printed):
    """Each line of the block was printed, in this order, with the same numbers but for a solver's digits."""
    rest = plain(printed)
    assert block.body.strip()
    for line in filter(None, map(plain, block.body.splitlines())):
        pattern = NUMBER.sub("(NUMBER)", line)
        match = re.search(re.escape(pattern).replace(r"\(NUMBER\)", f"({NUMBER.pattern})"), rest)
        assert match is not None, f"{block.place}: {line!r} was not printed; what was is\n{rest}"
        values = zip(NUMBER.findall(line), match.groups(), strict=True)
        assert all(float(a) == pytest.approx(float(b), rel=2e-2) for a, b in values), (
            f"{block.place}: {line}, {match[0]}"
        )
        rest = rest[match.end() :]


def plain(text):
    """Return the text without the lines of tables, each gap as one blank."""
    return " ".join(re.sub("[┃│]", " ", text).split())


@pytest.mark.parametrize(("what", "reason"), MARKED, ids=[what for what, _ in MARKED])
def test_marked_in_the_documentation(what, reason):
    pytest.skip(f"not run: {what}: {reason}")
