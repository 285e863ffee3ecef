"""Output of a run: text, HTML report, tables, pictures, fields for ParaView."""
