<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<!-- class.tif, band 2: why a tile has no class. Tiles that have one, and places without points, stay clear. -->
<qgis version="3.22.0" styleCategories="Symbology">
  <pipe>
    <rasterrenderer type="paletted" band="2" opacity="1" alphaBand="-1" nodataColor="">
      <colorPalette>
        <paletteEntry value="0" label="ok" color="#ffffff" alpha="0"/>
        <paletteEntry value="1" label="no points" color="#ffffff" alpha="0"/>
        <paletteEntry value="2" label="too few points" color="#bdbdbd" alpha="255"/>
        <paletteEntry value="3" label="too many holes" color="#737373" alpha="255"/>
        <paletteEntry value="4" label="no ground points" color="#8c6bb1" alpha="255"/>
        <paletteEntry value="5" label="outlier-only relief" color="#1b9e77" alpha="255"/>
      </colorPalette>
    </rasterrenderer>
  </pipe>
</qgis>
