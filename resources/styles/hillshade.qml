<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.22.0" styleCategories="Symbology" hasScaleBasedVisibilityFlag="0" maxScale="0" minScale="1e+08">
  <pipe>
    <provider>
      <resampling enabled="true" maxOversampling="2" zoomedInResamplingMethod="cubic" zoomedOutResamplingMethod="bilinear"/>
    </provider>
    <rasterrenderer type="hillshade" band="1" opacity="0.6" alphaBand="-1" nodataColor="" angle="45" azimuth="315" zfactor="1" multidirection="1">
      <rasterTransparency/>
    </rasterrenderer>
    <brightnesscontrast brightness="30" contrast="0" gamma="1"/>
    <huesaturation colorizeOn="0" grayscaleMode="0" saturation="0"/>
    <rasterresampler maxOversampling="2" zoomedOutResampler="bilinear"/>
    <resamplingStage>provider</resamplingStage>
  </pipe>
  <blendMode>6</blendMode>
</qgis>
