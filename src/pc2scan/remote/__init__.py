"""Recordings at URLs: in buckets, on web servers, in memory; fsspec reads and writes them."""
