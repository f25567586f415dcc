<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<!-- heightmap.tif as a shaded relief. In a CRS in feet set zfactor to 3.28084: heights are metres. -->
<qgis version="3.22.0" styleCategories="Symbology">
  <pipe>
    <rasterrenderer type="hillshade" band="1" azimuth="315" angle="45" zfactor="1" multidirection="0"
                    opacity="1" alphaBand="-1" nodataColor=""/>
  </pipe>
</qgis>
