"""The commands: what their help says, their arguments, and the examples at its beginning."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple


class Argument(NamedTuple):
    """An argument of a command that is not in the table of options.

    Attributes
    ----------
    name
        The parameter of the command's function.
    metavar
        What stands for it in the help: ``SRC...`` may be several, ``TARGET SOURCE`` are two.
    help
        One or two sentences, without the default.
    spellings
        How an option is typed; empty for a positional argument.
    required
        Whether it must be there.
    default_text
        The default for users.
    is_path
        Whether it is a path.
    """

    name: str
    metavar: str
    help: str
    spellings: tuple[str, ...] = ()
    required: bool = False
    default_text: str = ""
    is_path: bool = True

    @property
    def shown(self) -> str:
        """How errors and tables name it: ``SRC...``, ``B``, ``-o``."""
        return self.spellings[0] if self.spellings else self.metavar.strip("[]")


class Command:
    """A command: its function, its help (a text, whose first line is in the list of commands), and examples.

    The door is ``module:function``: one of the library, whose result is shown, or one of the command line, which
    returns the exit status.
    """

    def __init__(self, door: str, text: str, *arguments: Argument, examples: dict[str, str]) -> None:
        self.door, self.help, self.arguments, self.examples = door, text, arguments, examples


_sources = partial(Argument, "sources", "SRC...", required=True)
_output = partial(Argument, "destination", spellings=("-o", "--output"))
_word = partial(Argument, is_path=False)

_DST = _output(
    "DST",
    "*.bag: ROS 1 bag; *.mcap: MCAP file; DIR/: a file in this folder, named after SRC; any other name: rosbag2 "
    "directory.",
    default_text="next to SRC, in SRC's format, with _scan (repair: _repaired) in its name",
)

#: The commands in the order of the help.
COMMANDS = {
    "convert": Command(
        "cli.convert:convert",
        """Convert recorded clouds to laser scans, or back.

        PointCloud2 becomes LaserScan, with the results of ROS's pointcloud_to_laserscan. All other topics are copied.
        Messages that cannot be converted are counted, listed, and reflected in the exit status.""",
        _sources("ROS 1 bag, rosbag2 directory, .db3 or .mcap file, or a URL; several are merged in time order."),
        _DST,
        examples={
            "pc2scan convert drive.bag --target-frame base_link --min-height 0.1": "writes drive_scan.bag",
            "pc2scan convert drive.bag -o drive.mcap --params-file params.yaml": "with the robot's parameters",
            "pc2scan convert drive.bag --preset slam_toolbox --target-frame base_link": "scans that SLAM takes",
        },
    ),
    "batch": Command(
        "cli.batch:batch",
        """Convert every recording of a dataset, each on its own, in several processes.

        If a recording fails, the others are still converted. A second run converts only what is missing, has changed or
        failed. OUT/manifest.jsonl has the result of each recording.""",
        _sources("Folders that have recordings; recordings; globs in quotes; URLs.")._replace(is_path=False),
        _output("OUT", "Folder for the results and manifest.jsonl.", required=True),
        examples={
            "pc2scan batch recordings/ -o scans/ --preset slam_toolbox": "every recording, several at a time",
            "pc2scan batch recordings/ -o scans/ --dataset dataset.yaml": "other options for some recordings",
            "pc2scan batch recordings/ -o scans/ --dry-run": "show what would be done, and why",
        },
    ),
    "export": Command(
        "exports.export:export",
        """Write scans with poses, the trajectory, or clouds as files for learning and evaluation.

        With any parameter of the projection, clouds are converted to scans first. Poses are interpolated as in tf2:
        messages without a pose at their stamp are skipped and counted, and the exit status is 3.""",
        _sources("Recordings with scans or clouds; several are merged in time order."),
        _output("OUT", "The file. DIR/: a file for each topic, in a new folder. For clouds: a folder.", required=True),
        examples={
            "pc2scan export scans.mcap -o scans.npz --pose-frame odom": "scans with poses, as NumPy arrays",
            "pc2scan export drive.bag -o scans.csv --min-height -0.3": "convert its clouds; one row per scan",
            "pc2scan export drive.bag -o clouds --format pcd": "one file per cloud",
        },
    ),
    "view": Command(
        "show.view:view",
        """Write a page that shows clouds and the scans made of them, to tune the parameters by eye.

        The page is one HTML file that needs no network. It computes the same scans as `pc2scan convert`, to the bit,
        and shows the command line for them. If a recording has no clouds, it shows the scans.""",
        _sources("Recordings with clouds or scans; several are merged in time order."),
        _output("PAGE", "The page, an HTML file.", default_text="next to SRC, with _view.html in its name"),
        examples={
            "pc2scan view drive.bag": "a page that shows its clouds and scans",
            "pc2scan view drive.bag --min-height 0.1 --max-height 1.5": "with scans of these heights",
        },
    ),
    "plot": Command(
        "cli.plot:plot",
        """Draw clouds from above and from the side, with the height band and the scan, for reports.

        Needs matplotlib: pip install "pc2scan[plot]". To tune parameters, use `pc2scan view`.""",
        _sources("Recordings with clouds; several are merged in time order."),
        _output("FIGURE", "The figure: *.png, *.svg or *.pdf.", required=True),
        examples={
            "pc2scan plot drive.bag -o figure.png --min-height -0.3 --max-height 1": "a cloud and its scan",
            "pc2scan plot drive.bag -o figure.pdf --frames 3": "three moments side by side",
        },
    ),
    "map": Command(
        "show.map:draw_map",
        """Draw the scans of a recording into a map, placed by the recorded odometry: a preview, not SLAM.

        Nothing is matched or corrected: doubled walls show that mounts, stamps or odometry do not fit together. Clouds
        are converted and drawn if there are no scans, if --topic names them, or with an option about conversion.""",
        _sources("Recordings with scans or clouds; several are merged in time order."),
        _output("MAP", "NAME.yaml: for map_server, with NAME.pgm and NAME.png. NAME.png: a picture.", required=True),
        examples={
            "pc2scan map scans.mcap -o map.png": "its scans, placed by the odometry",
            "pc2scan map drive.bag -o map.yaml --min-height 0.1 --max-height 1.5": "for map_server, of clouds",
        },
    ),
    "check": Command(
        "show.check:check",
        """Check whether SLAM and navigation accept a recording's scans.

        The verdict for each topic and consumer: accepted, shifted (by up to one beam), misplaced (beams or ranges in
        wrong places), ignored, or aborts (the consumer crashes); with the rule, the numbers and a remedy. Then defects
        and notices for all consumers.

        Exit status: 0 all accepted (without --for: or shifted, and no defect), 1 not all, 2 wrong usage.""",
        _sources("Recordings with scans; several are merged in time order."),
        examples={
            "pc2scan check scans.mcap": "do SLAM and navigation accept its scans?",
            "pc2scan check scans.mcap --for slam_toolbox --for nav2": "only these decide",
        },
    ),
    "info": Command(
        "show.info:info",
        """Describe a recording, its clouds and its scans.

        For clouds: fields, points, frame, and limits of their coordinates. For scans: beams, limits, and the
        consumers that accept them. Then how the lidar is mounted, and a convert command.""",
        _sources("Recordings; several are merged in time order."),
        examples={
            "pc2scan info drive.bag": "its topics, its clouds, and a command that converts them",
            "pc2scan info drive.bag --json": "the same as JSON, for programs",
        },
    ),
    "tf": Command(
        "cli.tf:tf",
        """Show the frames of a recording.

        It shows the tree, and the rate, first and last times, and largest gap of each frame. Unconnected parts are
        shown separately.""",
        _sources("Recordings; their transforms are merged."),
        _word("lookup", "TARGET SOURCE", "Print the transform from SOURCE to TARGET.", ("--lookup",)),
        _word("at", "TIME", "With --lookup: seconds since 1970, or a date and time. Default: the latest.", ("--at",)),
        examples={
            "pc2scan tf drive.bag": "its frames",
            "pc2scan tf drive.bag --lookup base_link lidar": "where the lidar is on the robot",
        },
    ),
    "repair": Command(
        "cli.convert:repair",
        """Write everything that can be recovered of a damaged recording, of any type, byte for byte.

        The exit status is 0 if nothing was damaged (DST is then a complete copy), 3 if something was. SRC is never
        changed.""",
        Argument("source", "SRC", "ROS 1 bag, rosbag2 directory, .db3 or .mcap file.", required=True),
        _DST,
        examples={
            "pc2scan repair drive.bag.active": "writes drive_repaired.bag",
            "pc2scan repair cut_off.mcap -o sound.mcap": "everything that can be recovered",
        },
    ),
    "diff": Command(
        "compare.diff:diff",
        """Show the differences between two recordings.

        Scans and clouds are compared message by message, matched by their header's stamp: repeated stamps in order,
        messages without a stamp by log time. All bits must be equal unless a tolerance is given. Container, compression
        and ROS version are not compared.

        Exit status: 0 the same, 1 different, 2 not comparable.""",
        Argument("a", "A", "A recording, the reference.", required=True),
        Argument("b", "[B]", "The recording to compare with it.", default_text="A itself, see --topic"),
        examples={
            "pc2scan diff before.bag after.mcap": "every scan and cloud, to the bit",
            "pc2scan diff before.bag after.mcap --rtol 1e-5": "with a tolerance",
        },
    ),
    "golden": Command(
        "cli.golden:golden",
        """Check conversions against their expected output.

        A case is a folder with input.bag (or input.mcap, input.db3, input/), params.yaml, and the expected output of
        the conversion, expected.txt (or expected.bag, expected.mcap, expected/). A case.yaml may name other inputs,
        further arguments of convert, and tolerances.

        Exit status: 0 all as expected, 1 some differ, 2 some could not be checked.""",
        Argument("folder", "DIR", "A folder of cases, or one case.", required=True),
        _word("pattern", "PATTERN", "Only cases whose name contains this or matches this glob.", ("-k",)),
        examples={
            "pc2scan golden golden/": "do conversions still give the expected output?",
            "pc2scan golden golden/turn --init drive.bag --start 12 --end 14": "make a case of two seconds",
            "pc2scan golden golden/ -k drive --update": "expect the present output from now on",
        },
    ),
}
