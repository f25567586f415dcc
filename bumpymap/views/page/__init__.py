"""Write report.html: one page that shows the layers of a map and says what they mean."""
