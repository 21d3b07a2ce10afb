"""What the three reports share: records of tables and diagrams, and their Markdown, SVG and HTML."""
