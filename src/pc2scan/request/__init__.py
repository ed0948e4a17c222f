"""What was asked: options, parameter files, launch files and scans files become one checked request."""
