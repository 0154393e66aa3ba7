//! The program `gs4d-mpi`: the command line of gs4d ([`gs4d::main`]) on the ranks of MPI.
//!
//! ```text
//! mpirun -n 4 gs4d-mpi train DATA -m METHOD --set schedule.batch=4 -o RUN
//! ```
//! `train` and `resume` are done by all ranks together, with the bits of one; everything else by the first. Built without the
//! cargo feature `mpi` there is one rank, and more are refused.

use std::process::ExitCode;

#[cfg(feature = "mpi")]
mod world;

#[cfg(feature = "mpi")]
fn main() -> ExitCode {
    world::main()
}

#[cfg(not(feature = "mpi"))]
fn main() -> ExitCode {
    // What Open MPI, MPICH and Slurm tell their processes.
    let size = ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_NTASKS"].iter().find_map(|name| std::env::var(name).ok());
    if size.is_some_and(|size| size.parse::<u32>().is_ok_and(|size| size > 1)) {
        use std::io::Write;
        let what = "error[ranks]: this gs4d-mpi knows no MPI\n  do   cargo build --release -p gs4d-mpi --features mpi";
        let _ = writeln!(std::io::stderr(), "{what}");
        return ExitCode::from(2);
    }
    gs4d::main(gs_train::ranks::alone())
}
