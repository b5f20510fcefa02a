// The terse-mpi command, started by mpirun: what `terse solve` does, over several processes and machines. Exit codes as
// terse has them: 0 done, 1 bad input, 2 usage, 3 numerical failure, 130 interrupted.

#include <unistd.h>

#include <cctype>
#include <chrono>
#include <csignal>
#include <iostream>
#include <new>
#include <string>
#include <thread>
#include <vector>

#include "terse/core/atomic_file.h"
#include "terse/core/error.h"
#include "terse/distributed/distributed_solver.h"
#include "terse_mpi/solve_command.h"

namespace {

// mpirun ends the others when one rank dies.
extern "C" void RemoveFilesAndExit(int) {
  terse::RemoveUncommittedFiles();
  constexpr char kText[] = "terse-mpi: error: told to stop: another rank died, or the run was interrupted\n";
  if (write(STDERR_FILENO, kText, sizeof kText - 1) < 0) _exit(130);
  _exit(130);
}

int Say(const std::string& cause, int code) {
  if (terse::RankOf(MPI_COMM_WORLD) == 0) std::cerr << "terse-mpi: error: " << cause << '\n';
  return code;
}

// An error that the ranks have not agreed on: the others may wait for this one for ever.
[[noreturn]] void Abort(const std::string& cause) {
  const int rank = terse::RankOf(MPI_COMM_WORLD);
  if (rank != 0) std::this_thread::sleep_for(std::chrono::seconds(2));  // if all have it, one says it
  std::cerr << "terse-mpi: error: rank " << rank << ": " << cause << std::endl;
  MPI_Abort(MPI_COMM_WORLD, 1);
  _exit(1);
}

int Run(const std::vector<std::string>& arguments, const terse::PetscSession& session) {
  CLI::App app("Pose graphs solved over several processes, by PETSc.", "terse-mpi");
  app.set_version_flag("--version", "terse-mpi " TERSE_VERSION);
  app.require_subcommand(1);
  terse::AddDistributedSolve(app, session);
  try {
    app.parse(std::vector<std::string>(arguments.rbegin(), arguments.rend()));
    return 0;
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() != 0)
      return Say(std::string(error.what()) + "\nRun with --help for more information.", 2);
    if (terse::RankOf(MPI_COMM_WORLD) == 0) app.exit(error);  // --help, --version
    return 0;
  } catch (const terse::RankError& error) {
    return Say(error.what(), error.Cause() == terse::RankError::Kind::kNumerical ? 3 : 1);
  } catch (const std::bad_alloc&) {
    Abort("out of memory");
  } catch (const std::exception& error) {
    Abort(error.what());
  }
}

}  // namespace

int main(int argc, char** argv) {
  std::vector<std::string> own, petsc;
  for (int k = 1; k < argc; ++k) {
    const std::string word = argv[k];
    const bool is_petsc = word.size() > 2 && word[0] == '-' && std::isalpha(static_cast<unsigned char>(word[1])) != 0;
    (is_petsc || !petsc.empty() ? petsc : own).push_back(word);
  }
  try {
    const terse::PetscSession session(petsc);
    for (const int signal : {SIGINT, SIGTERM, SIGHUP}) std::signal(signal, RemoveFilesAndExit);
    const int code = Run(own, session);
    std::signal(SIGTERM, SIG_IGN);  // mpirun's, when another is gone with a code: this one goes anyway
    return code;
  } catch (const std::exception& error) {
    std::cerr << "terse-mpi: error: " << error.what() << '\n';
    return 1;
  }
}
