"""What the repository makes and the wheel does not ship: data and tables of pages."""
