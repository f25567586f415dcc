<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<!-- obstacle.tif: what stands on the ground. Free ground stays clear. -->
<qgis version="3.22.0" styleCategories="Symbology">
  <pipe>
    <rasterrenderer type="paletted" band="1" opacity="1" alphaBand="-1" nodataColor="">
      <colorPalette>
        <paletteEntry value="0" label="free" color="#ffffff" alpha="0"/>
        <paletteEntry value="1" label="obstacle" color="#543005" alpha="255"/>
        <paletteEntry value="2" label="canopy" color="#7fbf7b" alpha="255"/>
        <paletteEntry value="3" label="unknown" color="#bebebe" alpha="255"/>
      </colorPalette>
    </rasterrenderer>
  </pipe>
</qgis>
