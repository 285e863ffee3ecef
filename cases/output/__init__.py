"""What is written of an outcome: text, pages, tables, pictures, fields."""
