"""Can the classes of scans be trusted? The two methods beside labels, beside each other, turned and timed."""
