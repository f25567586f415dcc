<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<!-- roughness.tif, band 1: c_r in rad/m, from 0 (dark) to 0.8 and more (yellow). -->
<qgis version="3.22.0" styleCategories="Symbology">
  <pipe>
    <rasterrenderer type="singlebandpseudocolor" band="1" opacity="1" alphaBand="-1" nodataColor=""
                    classificationMin="0" classificationMax="0.8">
      <rastershader>
        <colorrampshader colorRampType="INTERPOLATED" classificationMode="1" clip="0"
                         minimumValue="0" maximumValue="0.8" labelPrecision="2">
          <item value="0" label="0.0 rad/m" color="#440154" alpha="255"/>
          <item value="0.2" label="0.2" color="#3b528b" alpha="255"/>
          <item value="0.4" label="0.4" color="#21918c" alpha="255"/>
          <item value="0.6" label="0.6" color="#5ec962" alpha="255"/>
          <item value="0.8" label="0.8 and more" color="#fde725" alpha="255"/>
        </colorrampshader>
      </rastershader>
    </rasterrenderer>
  </pipe>
</qgis>
