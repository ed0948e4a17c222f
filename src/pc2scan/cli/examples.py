"""The examples at the beginning of each command's help."""

from __future__ import annotations

#: For each command: what is typed, and what it does.
EXAMPLES: dict[str, tuple[tuple[str, str], ...]] = {
    "convert": (
        ("pc2scan convert drive.bag --min-height 0.1 --max-height 1.5", "writes drive_scan.bag"),
        ("pc2scan convert drive.bag -o drive.mcap --params-file params.yaml", "with the parameter file of the robot"),
        ("pc2scan convert drive.bag --preset slam_toolbox --target-frame base_link", "scans that SLAM takes"),
    ),
    "batch": (
        ("pc2scan batch recordings/ -o scans/ --preset slam_toolbox", "every recording, several at a time"),
        ("pc2scan batch recordings/ -o scans/ --dataset dataset.yaml", "other options for some recordings"),
        ("pc2scan batch recordings/ -o scans/ --dry-run", "show what would be done, and why"),
    ),
    "export": (
        ("pc2scan export scans.mcap -o scans.npz --pose-frame odom", "scans with the robot's pose, as NumPy arrays"),
        ("pc2scan export drive.bag -o scans.csv --min-height -0.3", "convert its clouds; one row per scan"),
        ("pc2scan export drive.bag -o clouds --format pcd", "one file per cloud"),
    ),
    "view": (
        ("pc2scan view drive.bag", "a page that shows its clouds and scans"),
        ("pc2scan view drive.bag --min-height 0.1 --max-height 1.5", "with scans of these heights"),
    ),
    "plot": (
        (
            "pc2scan plot drive.bag -o figure.png --min-height -0.3 --max-height 1",
            "a cloud, the height band, and the scan",
        ),
        ("pc2scan plot drive.bag -o figure.pdf --frames 3", "three moments side by side"),
    ),
    "map": (
        ("pc2scan map scans.mcap --png map.png", "its scans, placed by the odometry"),
        ("pc2scan map drive.bag -o map.yaml --min-height 0.1 --max-height 1.5", "a map for map_server, made of clouds"),
    ),
    "check": (
        ("pc2scan check scans.mcap", "do SLAM and navigation accept its scans?"),
        ("pc2scan check scans.mcap --for slam_toolbox --for nav2", "only these decide"),
    ),
    "info": (
        ("pc2scan info drive.bag", "its topics, and the heights of its points"),
        ("pc2scan info drive.bag --json", "the same as JSON, for programs"),
    ),
    "tf": (
        ("pc2scan tf drive.bag", "its frames"),
        ("pc2scan tf drive.bag --lookup base_link lidar", "where the lidar is on the robot"),
    ),
    "repair": (
        ("pc2scan repair drive.bag.active", "writes drive_repaired.bag"),
        ("pc2scan repair cut_off.mcap -o sound.mcap", "everything that can be recovered"),
    ),
    "diff": (
        ("pc2scan diff before.bag after.mcap", "every scan and cloud, to the bit"),
        ("pc2scan diff before.bag after.mcap --rtol 1e-5", "with a tolerance"),
        ("pc2scan diff drive.bag --topic /scan:=/scan2", "two topics of one recording"),
    ),
    "golden": (
        ("pc2scan golden golden/", "do conversions still give the expected output?"),
        (
            "pc2scan golden golden/turn --init drive.bag --start 12 --end 14",
            "make a new case of two seconds of a drive",
        ),
        ("pc2scan golden golden/ -k drive --update", "expect the present output from now on"),
    ),
}
