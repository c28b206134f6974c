"""What a newcomer needs: a short guide, a demonstration, and the words of a report.

The words are those of the manual's glossary, whose source, ``glossary.md``, lies beside this module.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from scan3d.cli.terminal import printable
from scan3d.errors import InputError
from scan3d.files.reading import did_you_mean

GUIDE = """\
scan3d: seeing by touch.  A flexible rod is swept along a body, and the body is reconstructed from the reactions at its clamp.

  scan3d demo                        scan a body that comes with the program
  scan3d scan part.stl --out out     scan your own convex mesh (mm, unless you say --unit in)
  scan3d show out                    look at the result; out/view.html opens in any browser
  scan3d reconstruct log.csv --out out
                                     reconstruct a body from measurements
  scan3d explain certificate         what a word of the report means
  scan3d doctor                      what works on this machine
  scan3d --help                      all commands
"""
EXAMPLES = {
    "demo": """\
  scan3d demo
  scan3d demo --out here""",
    "explain": """\
  scan3d explain
  scan3d explain Hausdorff distance
  scan3d explain coverage""",
}
DEMO = Path(__file__).with_name("demo.glb")
"""The body of the demonstration, that of ``meshes/gem.glb``."""
# Settings of the demonstration: half the slices of the default take half the time.
DEMO_SETTINGS = {"slices": 32, "friction": "0.1:0.4"}
_GLOSSARY = Path(__file__).with_name("glossary.md")
# What the glossary writes in TeX, as plain characters.
_TEX = {
    "varphi": "φ", "kappa": "κ", "alpha": "α", "zeta": "ζ", "mu": "μ", "beta": "β", "omega": "ω", "delta": "δ", "theta": "θ",
    "pi": "π", "partial": "∂", "int": "∫", "langle": "⟨", "rangle": "⟩", "tilde": "~", "sin": "sin ", "cos": "cos ",
    "arctan": "arctan ", "max": "max",
}  # fmt: skip


class Term(NamedTuple):
    """An entry of the glossary, in plain text."""

    name: str
    definition: str
    symbol: str
    unit: str
    section: str


def glossary() -> list[Term]:
    """All entries, in their order."""
    found, section = [], ""
    for line in _GLOSSARY.read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            section = line[3:]
        cells = [_plain(cell.strip()) for cell in line.strip("|").split(" | ")]
        if line.startswith("|") and len(cells) == 4 and cells[0] not in ("term", "---"):
            name, definition, symbol, unit = cells
            found.append(Term(name, definition, symbol, unit, section))
    return found


def _plain(text: str) -> str:
    """A cell of the glossary without the marks of Markdown and TeX."""

    def formula(match: re.Match[str]) -> str:
        plain = re.sub(r"\\([a-zA-Z]+)", lambda word: _TEX[word[1]], match[1])
        return re.sub(r"[\\{}]", "", plain).replace("∂ ", "∂")

    return re.sub(r"\$([^$]*)\$", formula, text).replace("`", "").strip()


def explain(words: str) -> str:
    """The entries that fit, as text: the term itself, else those that have the words in their name.

    Raises InputError if there is none.
    """
    terms = glossary()
    wanted = " ".join(words.replace("_", " ").lower().split())
    fitting = [term for term in terms if term.name.lower() == wanted]
    fitting = fitting or [term for term in terms if wanted in term.name.lower()]
    if not fitting:
        known = {term.name.lower(): term.name for term in terms}
        raise InputError(
            f"the glossary has no {words!r}{did_you_mean([wanted], known)}; 'scan3d explain' lists its {len(terms)} terms"
        )
    return "\n".join(f"{_heading(term)}\n  {term.definition}" for term in fitting)


def _heading(term: Term) -> str:
    details = [
        f"{name} {value}" for name, value in (("symbol", term.symbol), ("unit", term.unit)) if value not in ("–", "1")
    ]
    return f"{term.name} ({', '.join(details)})" if details else term.name


def overview() -> str:
    """All terms by section, as text."""
    terms = glossary()
    sections = dict.fromkeys(term.section for term in terms)
    return "\n".join(
        f"{section}: {', '.join(term.name for term in terms if term.section == section)}" for section in sections
    )


def add_demo(commands: Any, add_overwrite: Callable[[argparse.ArgumentParser], None]) -> argparse.ArgumentParser:
    """Add the command `demo` to the commands of the parser."""
    text = "scan a body that comes with the program, and say what to open"
    demo: argparse.ArgumentParser = commands.add_parser("demo", help=text)
    demo.add_argument(
        "--out", default="scan3d-demo", metavar="DIR", help="folder for the results (default scan3d-demo)"
    )
    add_overwrite(demo)
    demo.set_defaults(command="demo", strict=False)
    return demo


def add_explain(commands: Any) -> None:
    """Add the command `explain` likewise."""
    explaining = commands.add_parser("explain", help="what a word of a report or of the manual means")
    explaining.add_argument("term", metavar="TERM", nargs="*", help="the term; without it all terms are listed")
    explaining.set_defaults(command="explain")


def explain_command(arguments: argparse.Namespace) -> int:
    """Print what a term means, or all terms."""
    print(explain(" ".join(arguments.term)) if arguments.term else overview())
    return 0


def what_to_open(folder: str) -> str:
    """What to do after the demonstration."""
    page, place = printable(str(Path(folder) / "view.html")), printable(folder)
    return (
        f"\nOpen {page} in a browser; surface.png and cloud.png beside it are pictures.\n"
        f"{f'scan3d show {place}':35} an interactive window\n"
        "scan3d explain certified            what a word above means\n"
        "scan3d scan part.stl --out out      a scan of your own mesh"
    )


def print_guide() -> int:
    """Print the guide; the exit code."""
    print(GUIDE, end="")
    return 0
