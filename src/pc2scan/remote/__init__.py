"""Reads and writes recordings at URLs (buckets, web servers) by fsspec."""
