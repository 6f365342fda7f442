// Denoise a sequence of raw buffers with a stillray frame graph, the file that holds all stages:
//
//   denoise_sequence NAME.frame.onnx FRAMES WIDTH HEIGHT COUNT OUT
//
// FRAMES/0.f32, 1.f32, ... hold float32 from the top left: color, albedo, normal, depth, motion, one
// after the other (dump.py writes them). OUT/0.f32, ... get the pictures, 3 values a pixel.
#include <onnxruntime_cxx_api.h>

#include <chrono>
#include <cstdio>
#include <fstream>
#include <iostream>
#include <set>
#include <stdexcept>
#include <string>
#include <vector>

namespace {

// `stillray info NAME.frame.onnx --graph` tells all inputs and outputs, what they mean and their units.
struct Buffer {
  const char* name;
  int channels;   // values a pixel
  bool has_axis;  // whether the channels are an axis of the tensor
};
const std::vector<Buffer> kBuffers = {
    {"color", 3, true}, {"albedo", 3, true}, {"normal", 3, true},
    {"depth", 1, false}, {"motion", 2, true},
};
struct State {
  const char* past;
  const char* next;
  std::vector<int64_t> beginning;  // zeros of this shape, where there is no past
};
const std::vector<State> kStates = {
    {"past_mean", "next_mean", {1, 1, 4}},     {"past_guides", "next_guides", {1, 1, 4}},
    {"past_output", "next_output", {1, 1, 3}}, {"past_noise", "next_noise", {1, 1}},
    {"past_numbers", "next_numbers", {5}},     {"past_albedo", "next_albedo", {1, 1, 3}},
};

class Denoiser {
 public:
  explicit Denoiser(const std::string& graph)
      : session_(environment_, std::basic_string<ORTCHAR_T>(graph.begin(), graph.end()).c_str(),
                 options()) {
    Ort::AllocatorWithDefaultOptions allocator;
    for (size_t index = 0; index < session_.GetInputCount(); ++index) {
      inputs_.insert(session_.GetInputNameAllocated(index, allocator).get());
    }
    for (const State& state : kStates) {
      if (inputs_.count(state.past)) states_.push_back(state);  // some keep no albedo
    }
    reset();
  }

  // Forget the past: the next frame begins anew, as after a cut or a change of size.
  void reset() {
    state_.clear();
    for (const State& state : states_) state_.push_back(zeros(state.beginning));
  }

  // The picture, 3 values a pixel; it lives in the tensor. `values` must stay until the call returns.
  Ort::Value denoise(std::vector<float>& values, int64_t width, int64_t height) {
    std::vector<const char*> names, results = {"denoised"};
    std::vector<Ort::Value> inputs;
    size_t start = 0;
    for (const Buffer& buffer : kBuffers) {
      std::vector<int64_t> shape = {height, width};
      if (buffer.has_axis) shape.push_back(buffer.channels);
      const size_t count = static_cast<size_t>(width * height) * buffer.channels;
      if (start + count > values.size()) throw std::runtime_error("a frame is too short");
      names.push_back(buffer.name);
      inputs.push_back(Ort::Value::CreateTensor<float>(  // not copied
          memory_, values.data() + start, count, shape.data(), shape.size()));
      start += count;
    }
    float unknown = -1;  // what a buffer holds that is not given is its neutral value, 1 by 1 pixel
    const int64_t one[] = {1, 1};
    for (const char* name : {"samples", "filter_spread"}) {
      if (!inputs_.count(name)) continue;  // graphs that were made before it was known
      names.push_back(name);
      inputs.push_back(Ort::Value::CreateTensor<float>(memory_, &unknown, 1, one, 2));
    }
    for (size_t index = 0; index < states_.size(); ++index) {
      names.push_back(states_[index].past);
      inputs.push_back(std::move(state_[index]));
      results.push_back(states_[index].next);
    }
    std::vector<Ort::Value> found = session_.Run(Ort::RunOptions{nullptr}, names.data(), inputs.data(),
                                                 inputs.size(), results.data(), results.size());
    for (size_t index = 0; index < states_.size(); ++index) state_[index] = std::move(found[index + 1]);
    return std::move(found[0]);
  }

 private:
  static Ort::SessionOptions options() {
    Ort::SessionOptions options;
    // threads that wait for work between frames must not burn the host's processors
    options.AddConfigEntry("session.intra_op.allow_spinning", "0");
    return options;
  }

  Ort::Value zeros(const std::vector<int64_t>& shape) {
    Ort::AllocatorWithDefaultOptions allocator;
    Ort::Value value = Ort::Value::CreateTensor<float>(allocator, shape.data(), shape.size());
    const size_t count = value.GetTensorTypeAndShapeInfo().GetElementCount();
    std::fill_n(value.GetTensorMutableData<float>(), count, 0.0f);
    return value;
  }

  Ort::Env environment_{ORT_LOGGING_LEVEL_ERROR, "stillray"};
  Ort::Session session_;
  Ort::MemoryInfo memory_ = Ort::MemoryInfo::CreateCpu(OrtArenaAllocator, OrtMemTypeDefault);
  std::set<std::string> inputs_;
  std::vector<State> states_;
  std::vector<Ort::Value> state_;
};

std::vector<float> read(const std::string& path) {
  std::ifstream file(path, std::ios::binary | std::ios::ate);
  if (!file) throw std::runtime_error(path + " cannot be read");
  std::vector<float> values(static_cast<size_t>(file.tellg()) / sizeof(float));
  file.seekg(0);
  file.read(reinterpret_cast<char*>(values.data()), values.size() * sizeof(float));
  return values;
}

}  // namespace

int main(int count, char** words) try {
  if (count != 7) throw std::runtime_error("usage: GRAPH FRAMES WIDTH HEIGHT COUNT OUT");
  const int64_t width = std::stoll(words[3]), height = std::stoll(words[4]);
  Denoiser denoiser(words[1]);
  for (int index = 0; index < std::stoi(words[5]); ++index) {
    const std::string name = "/" + std::to_string(index) + ".f32";
    std::vector<float> values = read(words[2] + name);
    const auto before = std::chrono::steady_clock::now();
    const Ort::Value picture = denoiser.denoise(values, width, height);
    const std::chrono::duration<double, std::milli> took = std::chrono::steady_clock::now() - before;
    std::ofstream file(words[6] + name, std::ios::binary);
    file.write(reinterpret_cast<const char*>(picture.GetTensorData<float>()),
               3 * width * height * sizeof(float));
    if (!file.flush()) throw std::runtime_error(words[6] + name + " cannot be written");
    std::printf("frame %d: %.1f ms\n", index, took.count());
  }
  return 0;
} catch (const std::exception& error) {
  std::cerr << "error: " << error.what() << '\n';
  return 1;
}
