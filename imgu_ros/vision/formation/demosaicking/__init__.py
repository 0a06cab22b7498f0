"""Demosaicking methods, one to a file; `imgu_ros.vision.formation.demosaic.demosaic` chooses among them."""
