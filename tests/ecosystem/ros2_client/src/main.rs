//! Sends one goal of FollowJointTrajectory: `ros2_client ROUTER ACTION SECONDS X Y run|cancel`.
//!
//! Prints `accepted`, a line `feedback JOINTS` for the first feedback, and `result CODE TEXT`; or `rejected`.

use std::time::Duration;

use hiroz::action::ZAction;
use hiroz::context::ZContextBuilder;
use hiroz::entity::{TypeHash, TypeInfo};
use hiroz::msg::{SerdeCdrSerdes, ZMessage};
use hiroz::{Builder, Result};
use serde::{Deserialize, Serialize};

const LIMIT: Duration = Duration::from_secs(60);

macro_rules! message {
    ($name:ident { $($field:ident: $kind:ty),* $(,)? }) => {
        #[derive(Debug, Clone, Default, Serialize, Deserialize)]
        pub struct $name { $(pub $field: $kind),* }

        impl ZMessage for $name {
            type Serdes = SerdeCdrSerdes<$name>;
        }
    };
}

message!(Time { sec: i32, nanosec: u32 });
message!(Header { stamp: Time, frame_id: String });
message!(Point { positions: Vec<f64>, velocities: Vec<f64>, accelerations: Vec<f64>, effort: Vec<f64>, after: Time });
message!(Trajectory { header: Header, joint_names: Vec<String>, points: Vec<Point> });
message!(Vector { x: f64, y: f64, z: f64 });
message!(Quaternion { x: f64, y: f64, z: f64, w: f64 });
message!(Transform { translation: Vector, rotation: Quaternion });
message!(Twist { linear: Vector, angular: Vector });
message!(MultiPoint { transforms: Vec<Transform>, velocities: Vec<Twist>, accelerations: Vec<Twist>, after: Time });
message!(MultiTrajectory { header: Header, joint_names: Vec<String>, points: Vec<MultiPoint> });
message!(Tolerance { name: String, position: f64, velocity: f64, acceleration: f64 });
message!(ComponentTolerance { joint_name: String, component: u16, position: f64, velocity: f64, acceleration: f64 });
message!(Goal {
    trajectory: Trajectory,
    multi_dof_trajectory: MultiTrajectory,
    path_tolerance: Vec<Tolerance>,
    component_path_tolerance: Vec<ComponentTolerance>,
    goal_tolerance: Vec<Tolerance>,
    component_goal_tolerance: Vec<ComponentTolerance>,
    goal_time_tolerance: Time,
});
message!(GoalResult { error_code: i32, error_string: String });
message!(Feedback {
    header: Header,
    joint_names: Vec<String>,
    desired: Point,
    actual: Point,
    error: Point,
    multi_dof_joint_names: Vec<String>,
    multi_dof_desired: MultiPoint,
    multi_dof_actual: MultiPoint,
    multi_dof_error: MultiPoint,
});

fn info(name: &str, hash: &str) -> TypeInfo {
    TypeInfo::new(name, TypeHash::from_rihs_string(hash).expect("a hash"))
}

/// The hashes are those of Jazzy.
struct FollowJointTrajectory;

impl ZAction for FollowJointTrajectory {
    type Goal = Goal;
    type Result = GoalResult;
    type Feedback = Feedback;

    fn name() -> &'static str {
        "control_msgs::action::dds_::FollowJointTrajectory_"
    }

    fn send_goal_type_info() -> TypeInfo {
        info(
            "control_msgs::action::dds_::FollowJointTrajectory_SendGoal_",
            "RIHS01_b13789dddc325a7a962825c45e28c77d37237ec129dd0c34dc5994562938c57f",
        )
    }

    fn get_result_type_info() -> TypeInfo {
        info(
            "control_msgs::action::dds_::FollowJointTrajectory_GetResult_",
            "RIHS01_e3ceb38e3e1867c8dc0f46014df26e90eb93422f27e9e97f936e07f94be4bc8b",
        )
    }

    fn cancel_goal_type_info() -> TypeInfo {
        info(
            "action_msgs::srv::dds_::CancelGoal_",
            "RIHS01_573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a",
        )
    }

    fn feedback_type_info() -> TypeInfo {
        info(
            "control_msgs::action::dds_::FollowJointTrajectory_FeedbackMessage_",
            "RIHS01_80398fcb9674a79081a9906e2ccf0c804dd7cb15e22e362e606ee87186beab71",
        )
    }

    fn status_type_info() -> TypeInfo {
        info(
            "action_msgs::msg::dds_::GoalStatusArray_",
            "RIHS01_6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e",
        )
    }
}

#[tokio::main]
async fn main() -> Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [router, action, seconds, x, y, verb] = words.as_slice() else {
        return Err("ros2_client ROUTER ACTION SECONDS X Y run|cancel".into());
    };
    let context = ZContextBuilder::default()
        .disable_multicast_scouting()
        .with_connect_endpoints([router.as_str()])
        .with_mode("client")
        .build()?;
    let node = context.create_node("tutti_test").build()?;
    let client = node.create_action_client::<FollowJointTrajectory>(action).build()?;
    if !client.wait_for_server(LIMIT).await {
        return Err("no such action in the graph".into());
    }
    let mut goal = Goal::default();
    goal.trajectory.joint_names = vec!["gantry.x".into(), "gantry.y".into()];
    goal.trajectory.points = vec![Point {
        positions: vec![x.parse()?, y.parse()?],
        after: Time { sec: seconds.parse()?, nanosec: 0 },
        ..Point::default()
    }];
    let Ok(mut handle) = client.send_goal(goal).await else {
        println!("rejected");
        return Ok(());
    };
    println!("accepted");
    let mut feedback = handle.feedback().expect("feedback once");
    if let Some(part) = tokio::time::timeout(LIMIT, feedback.recv()).await? {
        println!("feedback {}", part.joint_names.join(" "));
    }
    if verb == "cancel" {
        println!("cancel {}", handle.cancel().await?.return_code);
    }
    let result = handle.result_with_timeout(LIMIT).await?;
    println!("result {} {}", result.error_code, result.error_string);
    Ok(())
}
