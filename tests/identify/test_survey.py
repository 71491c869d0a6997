"""`twin.identify.survey`: What a log holds, and a command line that works."""

import json
import re
import shlex

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.io import savemat

from twin.base.errors import LogError
from twin.cli.understand import identify
from twin.identify.any_logs import read_any
from twin.identify.log_columns import wanted_columns
from twin.identify.survey import survey

T = np.arange(0.0, 4.0, 0.02)
X = 0.05 * np.sin(1.3 * T)
U = 0.1 * np.cos(T)


def write(path, header, *columns):
    rows = zip(*columns, strict=True)
    lines = [header, *(",".join(f"{each:.9g}" for each in row) for row in rows)]
    path.write_text("\n".join(lines))
    return path


FORMS = {
    "millis,X,servo": (1e3 * T, 1e3 * X, np.degrees(U)),
    "t [s],ball_x [mm],u [rad]": (T, 1e3 * X, U),
    "ms,X,servo_deg": (1e3 * T, 1e3 * X, np.degrees(U)),
    "ts,X,servo_deg": (T, 1e3 * X, np.degrees(U)),
    "time_us,px,roll": (1e6 * T, X, U),
    "t,cam_x_cm,cmd_x_deg": (T, 1e2 * X, np.degrees(U)),
}


@pytest.mark.parametrize("header", FORMS)
def test_the_guessed_columns_give_the_log_in_si_units(tmp_path, header):
    found = survey(write(tmp_path / "a.csv", header, *FORMS[header]))
    program, command, file, option, columns = shlex.split(found.command)
    assert (program, command, option) == ("ballplate", "identify", "--columns")
    axis = read_any(tmp_path / file, wanted_columns(columns)).axes["x"]
    assert axis.sampled == pytest.approx(T, abs=1e-6)
    assert axis.ball == pytest.approx(X, abs=1e-6)
    assert axis.tilt == pytest.approx(U, abs=1e-6)
    assert all(guess.why for guess in found.guesses)


def test_the_suggested_line_keeps_what_was_typed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "a.csv", "t,X,servo", T, 1e3 * X, np.degrees(U))
    typed = ["a.csv", "--on", "tube", "--ball", "solid", "--json"]
    found = json.loads(CliRunner().invoke(identify, typed, obj=None).output)
    assert shlex.split(found["command"])[1:-2] == typed[:-1]
    assert shlex.split(found["command"])[-2] == "--columns"


def test_gaps_repeated_stamps_and_steps_back_are_counted(tmp_path):
    time = T.copy()
    time[50:] += 1.5
    time[101] = time[100]
    time[150:] -= 3.0
    (line,) = survey(write(tmp_path / "a.csv", "t,x,u", time, X, U)).notes
    assert line.startswith("t: 50 rows per s over")
    assert "1 gap, the longest 1.52 s" in line
    assert "1 repeated stamp" in line
    assert "1 step back" in line


def test_a_column_whose_time_falls_is_no_time_and_a_lacking_role_is_a_blank(tmp_path):
    found = survey(write(tmp_path / "a.csv", "t,ball_x,noise", T[::-1], X, U))
    assert [guess.role for guess in found.guesses] == ["measured_x"]
    assert "time=NAME:s," in found.command
    assert "command_phi=NAME:deg" in found.command


def test_a_sample_time_that_stays_and_pulses_in_us_are_no_time(tmp_path):
    header = "Ts,us,ball_x"
    found = survey(write(tmp_path / "a.csv", header, 0.02 + 0 * T, 1500 + 400 * np.sin(T), X))
    assert [guess.role for guess in found.guesses] == ["measured_x"]


def test_identify_without_columns_shows_the_log_and_exits_with_1(tmp_path):
    file = write(tmp_path / "a.csv", "millis,X,servo", 1e3 * T, 1e3 * X, np.degrees(U))
    how = {"catch_exceptions": False, "standalone_mode": False}
    done = CliRunner().invoke(identify, [str(file)], **how)
    assert done.return_value == 1
    asked = "--columns time=millis:ms,measured_x=X:mm,command_phi=servo:deg"
    assert asked in " ".join(done.output.split())
    done = CliRunner().invoke(identify, [str(file), "--json"], **how)
    assert done.return_value == 1
    assert json.loads(done.stdout)["roles"]["measured_x"]["column"] == "X"


NAMES = {
    "t,ball_u,ball_v,servo_a,servo_b": "ball_u ball_v servo_a servo_b",
    "t,ball_x,ball_u,ball_y,cmd_x,cmd_y": "ball_x ball_y cmd_x cmd_y",
    "t,ball_u,cmd": "- - cmd -",
    "t,x,y,vx,vy,roll,pitch": "x y roll pitch",
    "t,ref_x,ref_y,meas_x,meas_y,cmd_x,cmd_y": "meas_x meas_y cmd_x cmd_y",
    "t,ballX,ballY,plateRoll,platePitch": "ballX ballY plateRoll platePitch",
    "t,servo1,servo2,servo3,x_px,y_px,tilt_x,tilt_y": "x_px y_px tilt_x tilt_y",
    "t,servo_a,servo_b,servo_c,x,y,tilt_x,tilt_y": "x y tilt_x tilt_y",
    "t,motor0,motor1,motor2,motor3,x,y": "x y - -",
    "t,kugel_x,kugel_y,soll_x,soll_y,winkel_x,winkel_y": "kugel_x kugel_y winkel_x winkel_y",
    "t,data.0,data.1,data.2,pos.1,pos.2,cmd.1,cmd.2": "pos.1 pos.2 cmd.1 cmd.2",
    "t,xpos,ypos,servox,servoy": "xpos ypos servox servoy",
    "t,y1,y2,u1,u2": "y1 y2 u1 u2",
    "t,px,py,ux,uy": "px py ux uy",
    # of one axis, whatever it is called
    "t,r,y,u": "y - u -",
    "t,r,theta": "r - theta -",
    "t,x,theta": "x - theta -",
    "t,setpoint,position,error,output": "position - output -",
    "t,roll_setpoint,ball_pos": "ball_pos - roll_setpoint -",
    "t,pos_est,pos_raw,servo_cmd,servo_pos": "pos_raw - servo_cmd -",
    "t,Abstand [mm],Stellgröße [deg]": "Abstand - Stellgröße -",
    "Zeit [s],Kugelposition x [mm],Kugelposition y [mm],Stellwinkel x [°],Stellwinkel y [°]": (
        "Kugelposition x|Kugelposition y|Stellwinkel x|Stellwinkel y"
    ),
    "Zeit in s,Kugel x in mm,Kugel y in mm,Plattenwinkel-Soll x in °,Plattenwinkel-Soll y in °": (
        "Kugel x in mm|Kugel y in mm|Plattenwinkel-Soll x in °|Plattenwinkel-Soll y in °"
    ),
    "temps_ms,bille_x_mm,bille_y_mm,commande_x_deg,commande_y_deg": (
        "bille_x_mm bille_y_mm commande_x_deg commande_y_deg"
    ),
    "Tiempo [s],Posicion X [mm],Posicion Y [mm],Angulo X [deg],Angulo Y [deg]": (
        "Posicion X|Posicion Y|Angulo X|Angulo Y"
    ),
    "tempo,palla_x,palla_y,comando_x,comando_y": "palla_x palla_y comando_x comando_y",
    "t,plate_x,plate_y,ball_x,ball_y": "ball_x ball_y - -",
    "t,motor_speed,x,voltage": "x - - -",
    "t,dist,pulse_us": "dist - pulse_us -",
    "t,StepX,StepY,time_step,X,Y": "X Y StepX StepY",
    "t,Messung/Kugel,Messung/Servo": "Messung/Kugel - Messung/Servo -",
    "t,X_u,X_est2,X_meas_Pxl,Y_u,Y_est2,Y_meas_Pxl": "X_meas_Pxl Y_meas_Pxl X_u Y_u",
    "t,x,y,MV_x,MV_y": "x y MV_x MV_y",
    "t,x,sensor_mv": "x - - -",
    "t,state_estimate.0,state_estimate.1,observation,action,cost.c": "observation - action -",
    # a setpoint of an angle or a servo is the command, one of a position is none
    "Temps [s],Position x [mm],Consigne x [°]": "Position x|-|Consigne x|-",
    "Temps [s],Position x [mm],Consigne x [mm],Commande x [°]": "Position x|-|Commande x|-",
    "Temps [s],Position x [mm],Consigne x [mm]": "Position x|-|-|-",
    "temps,position_bille_mm,consigne_servo_us,tension_moteur": (
        "position_bille_mm - consigne_servo_us -"
    ),
    "Zeit [s],Kugel x [mm],Sollwinkel x [°],Führungsgröße x [mm]": "Kugel x|-|Sollwinkel x|-",
    "Zeit [s],Lage [mm],Führungsgröße [mm],Stellgröße [V],Regelabweichung [mm]": (
        "Lage|-|Stellgröße|-"
    ),
    "Zeit [s],Istwert [mm],Sollwert [mm],Ausgang [V]": "-|-|Ausgang|-",
    "t,Abstand [mm],Soll [deg]": "Abstand|-|Soll|-",
    "Tiempo [s],Posición de la bola [mm],Consigna del servo [°]": (
        "Posición de la bola|-|Consigna del servo|-"
    ),
    "tiempo,posicion_mm,consigna_mm,señal de control": "posicion_mm|-|señal de control|-",
    "Tempo [s],Posizione pallina [mm],Riferimento [mm],Comando motore [V],Errore [mm]": (
        "Posizione pallina|-|Comando motore|-"
    ),
    "tempo [s],riferimento [rad],posizione [m]": "posizione|-|riferimento|-",
    "Tempo [s],Posição da bola [mm],Referência [mm],Ângulo [°],Velocidade [mm/s]": (
        "Posição da bola|-|Ângulo|-"
    ),
    "tempo,posicao_x_mm,posicao_y_mm,sinal de controle x,sinal de controle y": (
        "posicao_x_mm|posicao_y_mm|sinal de controle x|sinal de controle y"
    ),
    "Zaman [s],Top Konumu X [mm],Referans [mm],Servo Açısı [°],Hata [mm]": (  # noqa: RUF001
        "Top Konumu X|-|Servo Açısı|-"  # noqa: RUF001
    ),
    "Czas [s],Położenie kulki [mm],Wartość zadana [mm],Sygnał sterujący [V],Uchyb [mm]": (
        "Położenie kulki|-|Sygnał sterujący|-"
    ),
    "Czas [s],Pozycja x [mm],Pozycja y [mm],Kąt x [°],Kąt y [°]": (
        "Pozycja x|Pozycja y|Kąt x|Kąt y"
    ),
    "时间,小球位置X,小球位置Y,舵机角度X,舵机角度Y,误差X": (
        "小球位置X 小球位置Y 舵机角度X 舵机角度Y"
    ),
    "时间 [s],位置 [mm],目标位置 [mm],控制量": "位置|-|控制量|-",
    "时间 [s],位置 [mm],设定值 [mm],输出": "位置|-|输出|-",
    "时间 [s],位置 [mm],设定值 [°]": "位置|-|设定值|-",
    "t,x [V],setpoint [V],u [V]": "x|-|u|-",
    # other words of a path, and a measured position of the plate
    "t,payload.x,payload.servo,payload.vx": "payload.x - payload.servo -",
    "t,rig1.ball.x,rig1.cmd_vel.linear.x,rig1.servo.x": "rig1.ball.x - rig1.servo.x -",
    "t,imu/orientation/x,odom/linear/x,touch/x,servo/x": "touch/x - servo/x -",
    "t,motor_current,ball_x,motor_voltage": "ball_x - motor_voltage -",
    "t,current_x,target_x,cmd": "current_x - cmd -",
    # freshly written ones that once were not understood
    "Zeit,Ballposition X [mm],Ballposition Y [mm],Sollwinkel Roll [°],Sollwinkel Nick [°]": (
        "Ballposition X|Ballposition Y|Sollwinkel Roll|Sollwinkel Nick"
    ),
    "t,Kugelort [mm],Führungsgröße w [mm],Regelgröße [mm],Stellgröße u [V]": (
        "Kugelort|-|Stellgröße u|-"
    ),
    "Zeit,Istposition [mm],Sollposition [mm],Motorspannung [V]": "Istposition|-|Motorspannung|-",
    "Zeit,Kugel_x_mm,Kugel_y_mm,Vorgabe_x_grad,Vorgabe_y_grad": (
        "Kugel_x_mm Kugel_y_mm Vorgabe_x_grad Vorgabe_y_grad"
    ),
    "Temps (s),Position bille x (cm),Angle plateau x (deg),Consigne angle x (deg)": (
        "Position bille x|-|Consigne angle x|-"
    ),
    "Zeit / s,Kugelposition / mm,Sollposition / mm,Stellwinkel / °": (
        "Kugelposition|-|Stellwinkel|-"
    ),
    "t/s,x/mm,u/V": "x|-|u|-",
    "t,Top X [mm],Top Y [mm],Referans X [mm],Motor X Açı [°],Motor Y Açı [°]": (  # noqa: RUF001
        "Top X|Top Y|Motor X Açı|Motor Y Açı"  # noqa: RUF001
    ),
    "t,Setpoint x [mm],Speed x [mm],Plate x [mm],cmd": "-|-|cmd|-",
    "t,Abstand [V],Sollwert [V]": "Abstand|-|-|-",
    "t,odom/linear/x,servo/x": "- - servo/x -",
    "t,a/x,a/y,b/servo_x,b/servo_y": "a/x a/y b/servo_x b/servo_y",
    # a ball in short, next to its distance from the middle; what MATLAB draws; a car's commands
    "t,xb,yb,vx,vy,alpha,beta,dist": "xb yb alpha beta",
    "t,udata,xdata,xspdata": "xdata - udata -",
    "t,turn_command,ball_x_px,servo_target_us": "ball_x_px - servo_target_us -",
    "t,vehicle_position,x,yaw,tilt,wheel_pwm": "x - tilt -",
}


@pytest.mark.parametrize("header", NAMES)
def test_roles_follow_the_words_of_the_names(tmp_path, header):
    names = header.split(",")
    columns = [T] + [0.1 * np.sin((1 + 0.3 * k) * T + k) for k in range(1, len(names))]
    found = {
        guess.role: guess.column
        for guess in survey(write(tmp_path / "a.csv", header, *columns)).guesses
    }
    roles = "measured_x", "measured_y", "command_phi", "command_theta"
    between = "|" if "|" in NAMES[header] else " "
    assert between.join(found.get(role, "-") for role in roles) == NAMES[header]
    assert found["time"] == re.split(r" ?[\[(/]", names[0])[0]


def test_the_current_of_a_motor_is_no_angle_and_what_rises_evenly_no_position(tmp_path):
    file = write(tmp_path / "a.csv", "t,motor_current,x,position,servo", T, U, 5 * T, X, 2 * U)
    roles = {guess.role: guess.column for guess in survey(file).guesses}
    assert roles == {"time": "t", "measured_x": "position", "command_phi": "servo"}


def test_a_position_in_degrees_is_a_measured_angle(tmp_path):
    header = "t,Position x [mm],Lage x [°],Soll x [°]"
    file = write(tmp_path / "a.csv", header, T, 1e3 * X, np.degrees(U), np.degrees(1.1 * U))
    roles = {guess.role: guess.column for guess in survey(file).guesses}
    assert roles == {
        "time": "t",
        "measured_x": "Position x",
        "measured_phi": "Lage x",
        "command_phi": "Soll x",
    }


def test_a_measured_angle_is_told_from_a_command(tmp_path):
    file = write(tmp_path / "a.csv", "t,imu_roll,x,servo", T, U, X, 2 * U)
    roles = {guess.role: guess.column for guess in survey(file).guesses}
    assert roles["measured_phi"] == "imu_roll"
    assert roles["command_phi"] == "servo"


def test_units_of_the_rig_are_counts_and_pixels_ask_for_their_size(tmp_path):
    pixels, pulses = 320 + 6e3 * X, 1500 + 1e3 * U
    found = survey(write(tmp_path / "a.csv", "t,ball_px_x,pulse_us", T, pixels, pulses))
    assert found.command.endswith("measured_x=ball_px_x:SIZEmm,command_phi=pulse_us:counts")
    (why,) = (guess.why for guess in found.guesses if guess.role == "measured_x")
    assert "give the size of one in the place of SIZEmm, as 0.5mm" in why
    columns = shlex.split(found.command)[-1]
    with pytest.raises(LogError, match="measured_x: unit 'SIZEmm'; known: m, mm, cm"):
        wanted_columns(columns)
    wanted = wanted_columns(columns.replace("SIZE", "0.5"))
    ball = read_any(tmp_path / "a.csv", wanted).axes["x"].ball
    assert ball == pytest.approx(5e-4 * pixels, abs=1e-6)


def test_a_time_that_rises_unevenly_is_known_by_its_name(tmp_path):
    uneven = np.cumsum(np.tile([0.002, 0.002, 0.002, 0.074], len(T) // 4))
    found = survey(write(tmp_path / "a.csv", "timestamps,X,servo", uneven, X, U))
    assert "time=timestamps:s," in found.command


def test_the_range_of_large_numbers_shows_how_they_differ(tmp_path):
    found = survey(write(tmp_path / "a.csv", "now,x,u", 12345670.0 + 5 * T, X, U))
    ranges = {column.name: column.range for column in found.columns}
    assert ranges["now"] == "12345670 to 12345689.9"
    assert ranges["x"] == f"{X.min():.4g} to {X.max():.4g}"


def test_a_beam_of_a_metre_is_not_taken_for_centimetres(tmp_path):
    found = survey(write(tmp_path / "a.csv", "t,x,u", T, 18 * X, U))
    assert "measured_x=x:m," in found.command


def test_a_text_without_header_has_a_time_and_a_column_that_stands_has_no_role(tmp_path):
    rows = zip(1e3 * T, X, U, strict=True)
    file = tmp_path / "a.txt"
    file.write_text("\n".join(",".join(f"{each:.9g}" for each in row) for row in rows))
    assert survey(file).command.endswith(
        "--columns time=1:ms,measured_x=NAME:m,command_phi=NAME:deg"
    )
    held = write(tmp_path / "b.csv", "t,x,pos_x,u", T, 0 * X, X, U)
    assert "measured_x=pos_x:m" in survey(held).command


def test_a_column_that_states_its_unit_says_nothing_of_the_unit_of_another(tmp_path):
    header = "time,x,x_mm,theta,theta_deg"
    file = write(tmp_path / "a.csv", header, T, X, 1e3 * X, U, np.degrees(U))
    found = survey(file)
    axis = read_any(file, wanted_columns(shlex.split(found.command)[-1])).axes["x"]
    assert axis.ball == pytest.approx(X, abs=1e-6)
    assert axis.tilt == pytest.approx(U, abs=1e-6)


def test_two_axes_share_a_unit(tmp_path):
    header = "t,pos_x,pos_y,cmd_x,cmd_y"
    file = write(tmp_path / "a.csv", header, T, 100 * X, 2000 * X, 5 * U, 100 * U)
    asked = "measured_x=pos_x:mm,measured_y=pos_y:mm,command_phi=cmd_x:deg,command_theta=cmd_y:deg"
    assert survey(file).command.endswith(asked)


def test_a_column_that_counts_rows_is_no_time_in_ms(tmp_path):
    count = np.arange(len(T))
    found = survey(write(tmp_path / "a.csv", "t,X,servo", count, 1e3 * X, np.degrees(U)))
    assert "time=t:RATEHz," in found.command
    assert found.notes == (
        "t: counts rows, and is no time: give their rate in the place of RATEHz, as time=t:100Hz",
    )
    # a column of times is better, whatever its place; millis that step by 1 say that they are ms
    both = write(tmp_path / "b.csv", "t,seconds,X,servo", count, T, 1e3 * X, np.degrees(U))
    assert "time=seconds:s," in survey(both).command
    assert (
        "time=millis:ms,"
        in survey(
            write(tmp_path / "c.csv", "millis,X,servo", count, 1e3 * X, np.degrees(U))
        ).command
    )
    uneven = write(tmp_path / "d.csv", "t,X,servo", np.delete(np.arange(len(T) + 1), 7), X, U)
    assert "time=t:ms," in survey(uneven).command


def test_a_log_without_any_time_is_shown_the_form_of_a_constant_rate(tmp_path):
    found = survey(write(tmp_path / "a.csv", "X,servo", 1e3 * X, np.degrees(U)))
    assert "time=row:100Hz" in found.notes[0]


def test_names_that_do_not_fit_the_cells_give_no_roles(tmp_path):
    rows = [f"{k}\t{u:.5f}\t{u:.5f}\t{x:.5f}" for k, (x, u) in enumerate(zip(X, U, strict=True))]
    file = tmp_path / "a.txt"
    file.write_text("\n".join(["\t".join(("t", "I", "alpha1", "alpha2", "ball_x", "y")), *rows]))
    found = survey(file)
    assert [guess.option for guess in found.guesses] == ["time=1:RATEHz"]
    assert (
        "the header names 6 columns, the rows have 4 cells: no name of it is used" in found.notes[0]
    )
    told = wanted_columns("time=1:50Hz,measured_x=4:m,command_phi=2:rad")
    assert read_any(file, told).axes["x"].ball == pytest.approx(X, abs=1e-5)
    # whoever gives names is not refused, but warned
    by_name = wanted_columns("time=t:50Hz,measured_x=alpha2:m,command_phi=I:rad")
    assert "the header names 6 columns" in read_any(file, by_name).notes[0]
    # cells that are there, and empty, are no misfit
    file.write_text(
        "\n".join(
            [
                "t\tball_x\tcmd_x\tevent",
                *(f"{t}\t{x}\t{u}\t" for t, x, u in zip(T, X, U, strict=True)),
            ]
        )
    )
    assert "ball_x" in survey(file).command
    assert not read_any(file, wanted_columns("time=t,measured_x=ball_x,command_phi=cmd_x")).notes


def test_a_line_of_too_few_names_is_said_and_dates_are_the_time(tmp_path):
    rows = [
        f"2026-05-01 10:00:{t:09.6f},{x:.5f},{u:.5f},1" for t, x, u in zip(T, X, U, strict=True)
    ]
    rows[50] = rows[49]
    file = tmp_path / "a.csv"
    file.write_text("\n".join(["Timestamp,Data", *rows]))
    found = survey(file)
    assert found.guesses[0].option == "time=1:s"
    assert "has 2 names, the rows have 4 cells" in found.notes[0]


@pytest.mark.parametrize(
    ("command", "ball"), [("command_phi", "measured_x"), ("command_theta", "measured_y")]
)
def test_a_lacking_position_is_of_the_axis_of_the_command(tmp_path, command, ball):
    found = survey(write(tmp_path / "a.csv", f"t,foo,{command}", T, X, U))
    assert found.command.endswith(f"{ball}=NAME:m")
    assert f"{command}={command}" in found.command


def test_of_two_columns_of_one_name_the_noisy_one_is_measured(tmp_path):
    noisy = X + 3e-4 * np.random.default_rng(1).standard_normal(len(T))
    square = 0.05 * np.sign(X)
    for other in (0.05 * np.sin(T), square):
        for pair, name in (((other, noisy), "data.x.2"), ((noisy, other), "data.x.1")):
            found = survey(write(tmp_path / "a.csv", "t,data.x.1,data.x.2,servo", T, *pair, U))
            assert f"measured_x={name}:m" in found.command


def test_a_column_with_two_numbers_is_compared_with_none(tmp_path):
    file = tmp_path / "a.csv"
    rows = [f"{t:.2f},{x},{x if k in (3, 9) else ''},{u}"
            for k, (t, x, u) in enumerate(zip(T, X, U, strict=True))]  # fmt: skip
    file.write_text("\n".join(["t,data.x.1,data.x.2,servo", *rows]))
    assert "measured_x=data.x.1:m" in survey(file).command


def test_a_command_that_was_written_twice_is_not_that_of_the_other_axis(tmp_path):
    header = "t,pos_x,pos_y,angle_x,angle_y"
    file = write(tmp_path / "a.csv", header, T, X, X[::-1], U, U)
    found = survey(file)
    assert "command_phi=angle_x:rad,command_theta=NAME:deg" in found.command
    assert "angle_y equals angle_x in every row, up to the sign" in found.notes[0]
    turned = write(tmp_path / "c.csv", header, T, X, X[::-1], U, -U)
    assert survey(turned).notes[0] == found.notes[0]
    told = "time=t,measured_x=pos_x,measured_y=pos_y,command_phi=angle_x,command_theta=-angle_y"
    (note,) = read_any(file, wanted_columns(told)).notes
    assert "command_theta: angle_y equals angle_x (command_phi) in every row" in note
    other = write(tmp_path / "b.csv", header, T, X, X[::-1], U, np.append(U[:-1], U[-1] + 1e-3))
    assert not read_any(other, wanted_columns(told)).notes


COUNTERS = ["n", "index", "Frame", "Sample No.", "frame_idx", "", "Unnamed: 0", "step", "foo"]


@pytest.mark.parametrize("name", COUNTERS)
def test_a_column_that_counts_rows_is_a_time_whose_rate_has_to_be_given(tmp_path, name):
    count = np.arange(7, len(T) + 7)
    file = write(tmp_path / "a.csv", f"{name},X,servo", count, 1e3 * X, np.degrees(U))
    found = survey(file)
    asked = shlex.split(found.command)[-1]
    assert asked.startswith(f"time={name or 1}:RATEHz,")
    assert f"time={name or 1}:100Hz" in found.notes[0]
    axis = read_any(file, wanted_columns(asked.replace("RATEHz", "50Hz"))).axes["x"]
    assert axis.sampled == pytest.approx(T)
    assert axis.ball == pytest.approx(X, abs=1e-6)
    # any column of times is better
    header = f"{name},seconds,X,servo"
    both = write(tmp_path / "b.csv", header, count, T, 1e3 * X, np.degrees(U))
    assert "time=seconds:s," in survey(both).command


def test_a_counter_may_miss_rows_and_is_none_if_it_counts_anything_else(tmp_path):
    lossy = np.delete(np.arange(len(T) + 3), [5, 80, 81])
    found = survey(write(tmp_path / "a.csv", "frame,X,servo", lossy, 1e3 * X, np.degrees(U)))
    assert "time=frame:RATEHz," in found.command
    for numbers in (np.cumsum(lossy), np.ones(len(T)), 0.5 * lossy):
        file = write(tmp_path / "b.csv", "number,X,servo", numbers, 1e3 * X, np.degrees(U))
        assert "time=NAME:s," in survey(file).command


def test_columns_of_a_matrix_may_be_given_as_matlab_or_python_write_them(tmp_path):
    file = tmp_path / "a.mat"
    savemat(file, {"data": np.stack((T, 1e3 * X, U), 1), "gains": np.ones((3, 3))})
    forms = (
        "time=data(:,1),measured_x=data(:, 2):mm,command_phi=-data(:,3)",
        "time=data[:,0],measured_x=data[:,1]:mm,command_phi=-data[:, 2]",
        "time=data.1,measured_x=data.2:mm,command_phi=-data.3",
    )
    for form in forms:
        axis = read_any(file, wanted_columns(form)).axes["x"]
        assert axis.sampled == pytest.approx(T)
        assert axis.ball == pytest.approx(X)
        assert axis.tilt == pytest.approx(-U)
    np.save(tmp_path / "a.npy", np.stack((T, X, U), 1))
    told = wanted_columns("time=[:,0],measured_x=[:,1],command_phi=[:,2]")
    assert read_any(tmp_path / "a.npy", told).axes["x"].ball == pytest.approx(X)


def test_a_column_of_a_matrix_that_rises_evenly_is_guessed_to_be_the_time(tmp_path):
    file = tmp_path / "a.mat"
    savemat(file, {"m": np.stack((5 + T, X, U), 1), "ball": np.stack((T, X, X[::-1]), 1)})
    found = survey(file)
    roles = {guess.role: guess for guess in found.guesses}
    assert roles["time"].option == "time=ball.1:s"  # of the matrix that has the ball
    assert roles["time"].why.startswith("a guess: rises evenly in every row")
    assert roles["measured_x"].column == "ball.2"
    assert roles["measured_y"].column == "ball.3"
    uneven = 5 + T**3
    savemat(file, {"m": np.stack((uneven, X, U), 1)})
    assert "time=NAME:s" in survey(file).command


def test_a_time_of_day_is_told_by_its_cells_and_not_by_the_size_of_its_numbers(tmp_path):
    """A counter of 16 bits wraps at its numbers, a time of day at midnight, a date never."""
    short = (65000 + 1e3 * T) % 65536
    file = write(tmp_path / "a.csv", "t,x,servo", short, 1e3 * X, np.degrees(U))
    assert "wraps 1 time" in " ".join(survey(file).notes)
    dates = [f"1970-01-01 {int(t // 3600):02d}:{int(t // 60) % 60:02d}:{t % 60:05.2f}"
             for t in (86398 + T) % 86400]  # fmt: skip
    lines = [f"{t},{x},{u}" for t, x, u in zip(dates, X, U, strict=True)]
    file.write_text("\n".join(["t,x,servo", *lines]))
    assert "1 step back" in survey(file).notes[0]  # a date does not wrap
    file.write_text("\n".join(["t,x,servo", *(line[11:] for line in lines)]))
    assert "wraps 1 time" in " ".join(survey(file).notes)
    told = wanted_columns("time=t,measured_x=x:m,command_phi=servo:rad")
    assert read_any(file, told).axes["x"].sampled == pytest.approx(T)
