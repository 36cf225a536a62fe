"""Files of cameras as their programs write them."""

from __future__ import annotations

MESSAGE = """height: 480
width: 640
distortion_model: plumb_bob
D: [-0.1, 0.02, 1.0e-3, -2.0e-3, 0.0]
K: [500.0, 0.0, 321.0, 0.0, 501.0, 242.0, 0.0, 0.0, 1.0]
roi:
  height: 0
  width: 0
"""
ONE_A_LINE = """image_width: 640
image_height: 480
camera_matrix:
  cols: 3
  data:
  - 500.0
  - 0.0
  - 321.0
  - 0.0
  - 501.0
  - 242.0
  - 0.0
  - 0.0
  - 1.0
  rows: 3
distortion_model: plumb_bob
distortion_coefficients:
  cols: 5
  data:
  - -0.1
  - 0.02
  - 0.001
  - -0.002
  - 0.0
  rows: 1
"""
CHAIN = """%YAML:1.0
cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.1, 0.02, 0.001, -0.002]
  distortion_model: radtan
  intrinsics: [500.0, 501.0, 321.0, 242.0]
  resolution: [640, 480]
cam1:
  camera_model: pinhole
  distortion_coeffs: [-0.03, 0.05, -0.05, 0.01]
  distortion_model: equidistant
  intrinsics: [280.0, 281.0, 322.0, 243.0]
  resolution: [640, 480]
"""
COLMAP = "1 OPENCV 640 480 500 501 321.5 242.5 -0.1 0.02 0.001 -0.002\n2 PINHOLE 640 480 280 281 322.5 243.5\n"
FILESTORAGE = """%YAML:1.0
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 500., 0., 321., 0., 501., 242., 0., 0., 1. ]
dist_coeff: !!opencv-matrix
   rows: 4
   cols: 1
   dt: d
   data: [ -0.1, 0.02, 1.0e-03, -2.0e-03 ]
"""
OST = """# oST version 5.0 parameters

[image]

width
640

height
480

[narrow]

camera matrix
500.0 0.0 321.0
0.0 501.0 242.0
0.0 0.0 1.0

distortion
-0.1 0.02 0.001 -0.002 0.0

rectification
1.0 0.0 0.0
"""
CAMODOCAL = """%YAML:1.0
---
model_type: PINHOLE
image_width: 640
image_height: 480
distortion_parameters:
   k1: -0.1
   k2: 0.02
   p1: 0.001
   p2: -0.002
projection_parameters:
   fx: 500.0
   fy: 501.0
   cx: 321.0
   cy: 242.0
"""
ORB = "Camera.type: \"PinHole\"\n" + "".join(
    f"Camera.{name}: {value}\n" for name, value in {
        "fx": 500.0, "fy": 501.0, "cx": 321.0, "cy": 242.0, "k1": -0.1, "k2": 0.02, "p1": 0.001, "p2": -0.002,
        "width": 640, "height": 480,
    }.items()
)  # fmt: skip
SENSOR = """sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
rate_hz: 20
resolution: [640, 480]
camera_model: pinhole
intrinsics: [500.0, 501.0, 321.0, 242.0] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.1, 0.02, 0.001, -0.002]
"""
STORAGE = """<?xml version="1.0"?>
<opencv_storage>
<calibration_Time>"Thu"</calibration_Time>
<image_Width>640</image_Width>
<image_Height>480</image_Height>
<Camera_Matrix type_id="opencv-matrix">
  <rows>3</rows>
  <cols>3</cols>
  <dt>d</dt>
  <data>500. 0. 321. 0.
    501. 242. 0. 0. 1.</data></Camera_Matrix>
<Distortion_Coefficients type_id="opencv-matrix">
  <rows>5</rows>
  <cols>1</cols>
  <dt>d</dt>
  <data>-0.1 0.02 1e-3 -2e-3 0.</data></Distortion_Coefficients>
</opencv_storage>
"""
TOOLBOX = """%-- Focal length:
fc = [ 500.0 ; 501.0 ];
cc = [ 321.0 ; 242.0 ];
alpha_c = 0.000000000000000;
kc = [ -0.1 ; 0.02 ; 0.001 ; -0.002 ; 0.000000000000000 ];
fc_error = [ 0.3 ; 0.4 ];
nx = 640;
ny = 480;
"""
KANNALA = """%YAML:1.0
model_type: KANNALA_BRANDT
image_width: 640
image_height: 480
projection_parameters:
   k2: -0.01
   k3: 0.02
   k4: -0.03
   k5: 0.004
   mu: 280.0
   mv: 281.0
   u0: 321.0
   v0: 242.0
"""
TWO_EYES = """%YAML:1.0
Camera.type: "KannalaBrandt8"
Camera1.fx: 280.0
Camera1.fy: 281.0
Camera1.cx: 321.0
Camera1.cy: 242.0
Camera1.k1: -0.01
Camera1.k2: 0.02
Camera1.k3: -0.03
Camera1.k4: 0.004
Camera2.fx: 290.0
Camera2.fy: 291.0
Camera2.cx: 322.0
Camera2.cy: 243.0
Camera2.k1: 0.01
Camera2.k2: 0.0
Camera2.k3: 0.0
Camera2.k4: 0.0
Camera.width: 640
Camera.height: 480
"""
DOCUMENT = """<document version="1.5.0"><chunk><sensors>
<sensor id="0" label="left, 8 mm" type="frame"><resolution width="640" height="480"/>
<calibration type="frame" class="adjusted"><resolution width="640" height="480"/><f>501</f><cx>1.5</cx><cy>2.5</cy>
</calibration>
<calibration type="frame" class="initial"><resolution width="640" height="480"/><f>400</f></calibration></sensor>
<sensor id="1" label="right" type="frame"><resolution width="640" height="480"/>
<calibration type="frame" class="initial"><resolution width="640" height="480"/><f>502</f></calibration></sensor>
<sensor id="2" label="spare" type="frame"><resolution width="640" height="480"/></sensor>
</sensors></chunk></document>
"""
MRCAL = """{
    'lensmodel':  'LENSMODEL_OPENCV4',
    # intrinsics are fx,fy,cx,cy,distortion0,distortion1,....
    'intrinsics': [ 500, 501, 321, 242, -0.1, 0.02, 0.001, -0.002,],
    'extrinsics': [ 0, 0, 0, 0, 0, 0,],
    'imagersize': [ 640, 480,],
}
"""
CALIBRATION = """<?xml version="1.0" encoding="UTF-8"?>
<calibration>
  <projection>frame</projection>
  <width>640</width>
  <height>480</height>
  <f>501</f>
  <cx>1.5</cx>
  <cy>2.5</cy>
  <k1>-0.1</k1>
  <k2>0.02</k2>
  <p1>-0.002</p1>
  <p2>0.001</p2>
</calibration>
"""
MATLAB = """camera = cameraIntrinsics([500.0, 501.0], [322.0, 243.0], [480, 640], ...
  'RadialDistortion', [-0.1, 0.02], 'TangentialDistortion', [0.001, -0.002]);
"""
IN_BRACES = """image_width: 640
image_height: 480
camera_matrix: {rows: 3, cols: 3, data: [500.0, 0, 321.0, 0, 501.0, 242.0, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.1, 0.02, 0.001, -0.002, 0]}
"""
