"""Options, parameter files, launch files and scans files become one checked request."""
