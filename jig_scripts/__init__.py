"""Ready jig protocols and jig descriptions, as small files a lab can read, copy and change."""
