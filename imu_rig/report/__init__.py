"""Reports: one self-contained HTML file each, that reads well on paper and on a phone."""
