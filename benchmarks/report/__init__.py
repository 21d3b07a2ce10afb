"""The frame of all reports: records of tables and diagrams, measuring, and Markdown, SVG, JSON and HTML files."""
