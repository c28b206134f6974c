"""The arguments of the commands for a laboratory."""

from __future__ import annotations

from typing import Any

EXAMPLES = {
    "import": """\
  scan3d import log.csv --map rig.toml --guess
  scan3d import log.csv --map rig.toml --dry-run
  scan3d import log.csv --map rig.toml --out specimen.csv
  scan3d import log.csv --map rig.toml --rig calibrated.toml --out specimen.csv
  scan3d import further.csv --map rig.toml --after specimen.csv --out both.csv
  scan3d import run.bag --map rig.toml --out specimen.parquet""",
}
"""Examples that are printed below the help of a command."""


def add_import(commands: Any) -> Any:
    """Add `scan3d import` to the subparsers, and return its parser."""
    parser = commands.add_parser("import", help="a recording from a laboratory's table, which a map describes")
    parser.add_argument(
        "raw", metavar="RAW", help="a text table with any delimiter, a Parquet file, or a ROS bag (.bag, or its folder)"
    )
    parser.add_argument("--map", metavar="FILE", help="TOML file that says what the columns mean")
    parser.add_argument(
        "--rig",
        metavar="RIG",
        help="the .toml of a calibrated rig, whose frames and rod replace those of the map",
    )
    parser.add_argument(
        "--after",
        metavar="REC",
        help="an earlier recording, whose sweeps come before those of the table in the new one",
    )
    parser.add_argument(
        "--out", metavar="FILE", help="the recording, .csv or .parquet; a .toml of the same name is written as well"
    )
    parser.add_argument(
        "--guess",
        action="store_true",
        help="write a first map by the names of the columns, to --map or beside RAW, and stop",
    )
    parser.add_argument(
        "--dry-run",
        action="store_true",
        help="print what becomes of the first rows, and write a page with the curves only",
    )
    parser.add_argument(
        "--html",
        metavar="FILE",
        help="a page with raw and converted curves (default with --dry-run: RAW with the ending .html)",
    )
    parser.set_defaults(command="import", misuse=parser.error)
    return parser
