// What a controller in C++ needs of each line: where to grasp, and how far that may be off.
//
//     ringpose schema --cpp > ringpose.hpp
//     g++ -std=c++17 -O2 read_lines.cpp -o read_lines        # apt install g++ nlohmann-json3-dev
//     ringpose pose ... --track | ./read_lines
#include <cmath>
#include <iostream>
#include <string>
#include <variant>

#include "ringpose.hpp"

namespace {

const std::string& name_of(const ringpose::PoseLine& line) { return line.shot; }

std::string name_of(const ringpose::TrackLine& line) { return line.shot.value_or("-"); }

/// Standard deviation along the axis in which the grasp point is known least: at most the root of the trace.
double grasp_sd_m(const ringpose::RingPose& pose) {
  if (!pose.covariance || !pose.covariance->grasp) return INFINITY;
  const auto& grasp = *pose.covariance->grasp;
  return std::sqrt(grasp[0][0] + grasp[1][1] + grasp[2][2]);
}

template <class Line> void report(const Line& line) {
  std::cout << name_of(line) << ' ' << line.status;
  if (line.pose && line.pose->grasp_m) {
    const auto& [x, y, z] = *line.pose->grasp_m;
    std::cout << ' ' << x << ' ' << y << ' ' << z << " +- " << grasp_sd_m(*line.pose) << " m in " << line.frame;
  }
  for (const auto& flag : line.flags) std::cout << ' ' << flag;
  std::cout << '\n' << std::flush;
}

}  // namespace

int main() {
  int status = 0;
  for (std::string text; std::getline(std::cin, text);) {
    try {
      std::visit([](const auto& line) { report(line); }, ringpose::read_line(text));
    } catch (const ringpose::Error& error) {
      std::cerr << "read_lines: " << error.what() << '\n';
      status = 65;
    }
  }
  return status;
}
