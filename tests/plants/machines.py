"""Small MJCF files of machines that nobody has written a plant for."""

CAPSULE = '<geom type="capsule" contype="0" conaffinity="0"'
ROTARY = f"""<mujoco model="rotary pendulum">
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <light pos="0 0 2"/>
    <camera name="side" pos="0 -2 .4" xyaxes="1 0 0 0 0 1" fovy="30"/>
    <body pos="0 0 .3">
      <joint name="arm" axis="0 0 1" damping=".001"/>
      {CAPSULE} fromto="0 0 0 .2 0 0" size=".01" mass=".1" rgba=".8 .3 .2 1"/>
      <body pos=".2 0 0">
        <joint name="pole" axis="1 0 0" damping="1e-5"/>
        {CAPSULE} fromto="0 0 0 0 0 .25" size=".008" mass=".05" rgba=".3 .6 .9 1"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="drive" joint="arm"/></actuator>
  <sensor>
    <jointpos name="arm_encoder" joint="arm"/><jointpos name="pole_encoder" joint="pole"/>
    <jointvel name="arm_tacho" joint="arm"/><jointvel name="pole_tacho" joint="pole"/>
  </sensor>
  <keyframe><key name="hanging" qpos="0 3.141592653589793"/><key name="tilted" qpos="0 .3"/></keyframe>
</mujoco>"""
# a second pole that stands beside the first machine, on a hinge that nothing drives
UNDRIVEN = ROTARY.replace(
    "</worldbody>",
    f"""<body pos="1 0 0"><joint name="other" axis="0 1 0"/>
    {CAPSULE} fromto="0 0 0 0 0 .3" size=".01" mass=".1"/></body></worldbody>""",
)
# a body on a ball joint with a reaction wheel about each of two axes: its turn is a quaternion
TOP = f"""<mujoco model="balancing cube">
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body pos="0 0 .1">
      <joint name="foot" type="ball"/>
      {CAPSULE} fromto="0 0 0 0 0 .2" size=".02" mass=".3"/>
      <body pos="0 0 .2">
        <joint name="roll" axis="1 0 0"/>{CAPSULE} fromto="-.01 0 0 .01 0 0" size=".06" mass=".2"/>
      </body>
      <body pos="0 0 .2">
        <joint name="tilt" axis="0 1 0"/>{CAPSULE} fromto="0 -.01 0 0 .01 0" size=".06" mass=".2"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="roll" joint="roll"/><motor name="tilt" joint="tilt"/></actuator>
</mujoco>"""
FALLING = """<mujoco model="box"><worldbody>
  <geom name="floor" type="plane" size="1 1 .1"/>
  <body pos="0 0 .5"><joint name="box" type="free"/><geom type="box" size=".1 .1 .1" mass="1"/>
    <body pos="0 0 .1"><joint name="lid" axis="0 1 0" damping=".1" stiffness="1"/>
      <geom type="box" size=".05 .05 .01" pos="0 0 .02" contype="0" conaffinity="0" mass=".01"/></body></body>
</worldbody><actuator><motor name="lid" joint="lid"/></actuator></mujoco>"""
