"""How the report looks: colours, lines, inline SVG."""
