"""Climbs over solids: contact path, friction, time scaling and averages of a step climber."""
