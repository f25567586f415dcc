<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<!-- barred.tif: what bars a tile. Places without points stay clear. -->
<qgis version="3.22.0" styleCategories="Symbology">
  <pipe>
    <rasterrenderer type="paletted" band="1" opacity="1" alphaBand="-1" nodataColor="">
      <colorPalette>
        <paletteEntry value="0" label="passable" color="#a6d96a" alpha="255"/>
        <paletteEntry value="1" label="unknown ground" color="#969696" alpha="255"/>
        <paletteEntry value="2" label="obstacle" color="#543005" alpha="255"/>
        <paletteEntry value="3" label="too steep" color="#8073ac" alpha="255"/>
        <paletteEntry value="4" label="drives fail" color="#d7191c" alpha="255"/>
        <paletteEntry value="5" label="step" color="#e66101" alpha="255"/>
      </colorPalette>
    </rasterrenderer>
  </pipe>
</qgis>
