"""Two recordings compared: what differs between their scans and clouds, message by message."""
