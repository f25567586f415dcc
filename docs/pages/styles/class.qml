<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<!-- class.tif, band 1: the roughness class of each tile. -->
<qgis version="3.22.0" styleCategories="Symbology">
  <pipe>
    <rasterrenderer type="paletted" band="1" opacity="1" alphaBand="-1" nodataColor="">
      <colorPalette>
        <paletteEntry value="0" label="smooth" color="#2c7bb6" alpha="255"/>
        <paletteEntry value="1" label="fair" color="#abd9e9" alpha="255"/>
        <paletteEntry value="2" label="rough" color="#fdae61" alpha="255"/>
        <paletteEntry value="3" label="very rough" color="#d7191c" alpha="255"/>
      </colorPalette>
    </rasterrenderer>
  </pipe>
</qgis>
