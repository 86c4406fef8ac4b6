"""What QGIS's desktop shows beside the Processing Toolbox: the menu Plugins > REPM and its windows."""
