"""Draw pictures: ways over a map, classified scans."""
